"""A headless Chromium that hears what pages complain of."""

import shutil
from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="driving a browser needs playwright; pip install playwright"
    )
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium is installed; on Debian: apt install chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


class Tabs:
    """Opens tabs and hears what their pages complain of, and which addresses they ask for."""

    def __init__(self, browser: Any) -> None:
        self.browser, self.complaints = browser, []
        self.shared = self.open()  # by most tests: to open a tab takes longer than most of them

    def open(self, **options: Any) -> Any:
        page = self.browser.new_page(**options)
        page.set_default_timeout(20_000)
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self._check_address(request.url))
        return page

    def _check_address(self, url: str) -> None:
        if not url.startswith(("file:", "data:")):
            self.complaints.append(url)


@pytest.fixture(scope="module")
def tabs(browser: Any) -> Tabs:
    return Tabs(browser)
