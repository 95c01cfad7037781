"""A page opened in the installed Chromium, without a network, for tests that click through it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Page, sync_playwright


def browser() -> str:
    """The browser's program; the test is skipped without one."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    return found


@contextmanager
def opened(address: str, *, offline: bool = True, scheme: str = "light") -> Iterator[Page]:
    """A page that is ready. Fails where a script of it does."""
    with sync_playwright() as playwright:
        program = playwright.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
        view = {"width": 1200, "height": 900}
        page = program.new_context(offline=offline, color_scheme=scheme, viewport=view).new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        page.goto(address)
        page.wait_for_selector("body[data-ready=true]", timeout=120_000)
        yield page
        assert not errors and page.evaluate("document.body.dataset.error") is None, errors
        program.close()
