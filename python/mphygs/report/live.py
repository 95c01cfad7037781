"""The live viewer: a local page whose numbers can be moved, and the motion that follows from them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock

from mphygs.model.belief import Belief, Parameter
from mphygs.report.html import scene
from mphygs.report.page import document

# A logarithm moves this far from its fitted value, other numbers this many usual sizes.
LOG_REACH, SIZE_REACH = 1.5, 5.0
LARGEST_REQUEST = 1 << 16
# A connection that says nothing for so long is closed [s].
PATIENCE = 30


def reach_of(parameter: Parameter) -> tuple[float, float, float]:
    """Lowest, present and highest position of a parameter's slider: logarithms where it is fitted in them."""
    if parameter.log:
        now = math.log(parameter.value)
        return (
            max(now - LOG_REACH, math.log(parameter.lower)),
            now,
            min(now + LOG_REACH, math.log(parameter.upper)),
        )
    step = SIZE_REACH * parameter.scale
    now = parameter.value
    return max(now - step, parameter.lower), now, min(now + step, parameter.upper)


def moved_belief(belief: Belief, positions: Mapping[str, object]) -> Belief:
    """The belief with free parameters at slider positions. ValueError for what is no such position."""
    known = {p.key: p for p in belief.free}
    for key, position in positions.items():
        if key not in known:
            raise ValueError(f"parameter '{key}': expected one of {', '.join(known)}")
        if (
            isinstance(position, bool)
            or not isinstance(position, (int, float))
            or not math.isfinite(position)
        ):
            raise ValueError(f"parameter '{key}': got {position!r}, expected a number")
        value = math.exp(min(position, 700.0)) if known[key].log else float(position)
        value = min(max(value, known[key].lower), known[key].upper)
        belief = belief.with_parameter(key, value=value)
    return belief


def without_effects(belief: Belief, names: Sequence[object]) -> Belief:
    """The belief with effects switched off. ValueError for what is no effect of it."""
    for name in dict.fromkeys(map(str, names)):
        if name not in belief.effects:
            raise ValueError(f"effect '{name}': expected one of {', '.join(belief.effects) or 'none'}")
        belief = belief.without_effect(name)
    return belief


def live_page(name: str, belief: Belief, shown: Mapping[str, object]) -> str:
    """The page with a slider for every fitted parameter and a switch for every effect. shown: see
    `scene_document`."""
    sliders = []
    for parameter in belief.free:
        low, now, high = reach_of(parameter)
        log = ' data-log="1"' if parameter.log else ""
        key = escape(parameter.key)
        span = f'min="{low}" max="{high}" value="{now}"'
        slider = f'<input type="range" step="any" {span} data-key="{key}" aria-label="{key}"{log}>'
        value = f"<output>{parameter.value:.4g}</output>"
        sliders.append(f"<label>{key} [{escape(parameter.unit)}]</label>{slider}{value}")
    switches = "".join(
        f'<label><input type="checkbox" checked data-effect="{escape(effect)}"> {escape(effect)}</label>'
        for effect in dict.fromkeys(belief.effects)
    )
    effects = f'<div class="controls">effects: {switches}</div>' if switches else ""
    body = f"""<h1>{escape(name)}</h1>
{scene()}
{effects}<div class="sliders">{"".join(sliders)}</div>
<p id="status" class="tile" aria-live="polite">move a number to see the motion follow</p>"""
    return document(name, body, {"charts": [], "scene": shown}, "live.js")


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that goes away is no news."""


def live_server(
    port: int,
    page: str,
    simulate: Callable[[str, Mapping[str, object], Sequence[object]], Mapping[str, object]],
) -> ThreadingHTTPServer:
    """A server for this machine only: of its loopback address, for requests that name it as their host.

    simulate: (sequence, slider positions, effects switched off) -> JSON with "motion" and "rms"; what it
    raises for values that cannot be simulated is told in the reply. port 0: any free one.
    """
    one_at_a_time = Lock()

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE

        def _reply(self, code: int, kind: str, text: str) -> None:
            content = text.encode()
            self.send_response(code)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            self.wfile.write(content)

        def _refused(self) -> bool:
            """Whether another site sends its visitors here, by a name of its own or from its page."""
            own = [f"{host}:{self.server.server_address[1]}" for host in ("127.0.0.1", "localhost")]
            origin = self.headers.get("Origin")
            fine = self.headers.get("Host") in own and origin in (None, *(f"http://{host}" for host in own))
            if not fine:
                self._reply(403, "text/plain", f"not for this host; expected {own[0]}")
            return not fine

        def do_GET(self) -> None:
            if self._refused():
                return
            if self.path == "/":
                self._reply(200, "text/html", page)
            else:
                self._reply(404, "text/plain", "not here")

        def do_POST(self) -> None:
            if self._refused():
                return
            if self.path != "/motion":
                self._reply(404, "text/plain", "not here")
                return
            length = self.headers.get("Content-Length", "")
            if not length.isascii() or not length.isdigit() or int(length) > LARGEST_REQUEST:
                expected = f"expected a Content-Length of at most {LARGEST_REQUEST}"
                self._tell(400, {"error": f"request: {expected}"})
                return
            try:
                asked = json.loads(self.rfile.read(int(length)))
                name, positions = str(asked["sequence"]), dict(asked["parameters"])
                off = list(asked.get("without", ()))
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                expected = '{"sequence": name, "parameters": {key: position}, "without": [effect]}'
                self._tell(400, {"error": f"request: expected JSON: {expected}"})
                return
            try:
                with one_at_a_time:
                    answer = simulate(name, positions, off)
            except (ValueError, KeyError, TypeError, RuntimeError, ArithmeticError) as error:
                answer = {"error": " ".join(str(error).split())}
            self._tell(200, answer)

        def _tell(self, code: int, answer: Mapping[str, object]) -> None:
            self._reply(code, "application/json", json.dumps(answer, allow_nan=False))

        def log_message(self, *_: object) -> None:
            """Requests are no news."""

    return _Server(("127.0.0.1", port), Handler)
