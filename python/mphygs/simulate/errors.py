"""Errors of a simulation run."""


class SimulationError(RuntimeError):
    """An unstable or impossible run; the message names the frame, the part and the cause.

    frame: first output frame that could not be computed (-1: not known);
    part: index of the part (-1: not known);
    shorter: whether shorter steps before that frame may do.
    """

    def __init__(self, message: str, *, frame: int = -1, part: int = -1, shorter: bool = False) -> None:
        super().__init__(message)
        self.frame = frame
        self.part = part
        self.shorter = shorter


class Halted(Exception):
    """A run that was not begun: whoever asked for it has stopped waiting."""
