"""The live viewer: a local page whose numbers can be moved, and the motion that follows from them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock

from mphygs.model.belief import Belief, Parameter
from mphygs.report.html import asset, viewer

# A logarithm moves this far from its fitted value, other numbers this many usual sizes.
LOG_REACH, SIZE_REACH = 1.5, 5.0
LARGEST_REQUEST = 1 << 16


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


def live_page(name: str, belief: Belief, motions: Mapping[str, object]) -> str:
    """The page with a slider for every fitted parameter."""
    sliders = []
    for parameter in belief.free:
        low, now, high = reach_of(parameter)
        log = ' data-log="1"' if parameter.log else ""
        key = escape(parameter.key)
        span = f'min="{low}" max="{high}" value="{now}"'
        slider = f'<input type="range" step="any" {span} data-key="{key}"{log}>'
        value = f"<output>{parameter.value:.4g}</output>"
        sliders.append(f"<label>{key} [{escape(parameter.unit)}] {slider} {value}</label><br>")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mphygs: {escape(name)}</title>
<style>{asset("style.css")}</style></head><body><h1>{escape(name)}</h1>
{viewer(motions)}
<p>{"".join(sliders)}</p><p id="status" class="quiet">move a number to see the motion follow</p>
<script>{asset("live.js")}</script></body></html>
"""


def live_server(
    port: int, page: str, simulate: Callable[[str, Mapping[str, object]], Mapping[str, object]]
) -> ThreadingHTTPServer:
    """A server for this machine only. simulate: (sequence, slider positions) -> JSON with "motion" and "rms".

    ValueError, KeyError and RuntimeError of simulate are told in the reply. port 0: any free one.
    """
    one_at_a_time = Lock()

    class Handler(BaseHTTPRequestHandler):
        def _reply(self, code: int, kind: str, text: str) -> None:
            content = text.encode()
            self.send_response(code)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def do_GET(self) -> None:
            if self.path == "/":
                self._reply(200, "text/html", page)
            else:
                self._reply(404, "text/plain", "not here")

        def do_POST(self) -> None:
            length = int(self.headers.get("Content-Length", "0"))
            if self.path != "/motion" or length > LARGEST_REQUEST:
                self._reply(404, "text/plain", "not here")
                return
            try:
                asked = json.loads(self.rfile.read(length))
                with one_at_a_time:
                    answer = simulate(str(asked["sequence"]), dict(asked["parameters"]))
            except (ValueError, KeyError, TypeError, RuntimeError) as error:
                answer = {"error": " ".join(str(error).split())}
            self._reply(200, "application/json", json.dumps(answer, allow_nan=False))

        def log_message(self, *_: object) -> None:
            """Requests are no news."""

    return ThreadingHTTPServer(("127.0.0.1", port), Handler)
