"""From videos alone: a small daisy, made with known truth, its parts and materials found again."""

import tempfile
from pathlib import Path

from mphygs.__main__ import main as command

import mphygs

SMALL = ("--size", "80", "--frames", "24", "--cameras", "3", "--rest-views", "12")


def main(folder: Path) -> mphygs.Fit:
    """Make it, then fit: Gaussians, parts, tracks and contact come first."""
    command(["synth", "flower", "--species", "daisy", "--out", str(folder / "daisy"), *SMALL])
    found = mphygs.fit(folder / "daisy", out=folder / "found", spacing=0.008)
    print(found.title())
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        main(Path(place))
