"""Pages in a headless Chromium, where there is one."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "headless_shell")


def in_browser(address: str, folder: Path, wait_ms: int = 3000) -> str:
    """The page as it is after so much of its own time, as HTML; it has said no error. Skips without a browser."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        pytest.skip("no Chromium was found: the page was not run (Debian: apt install chromium)")
    words = [browser, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle"]
    words += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", f"--user-data-dir={folder / 'profile'}"]
    words += ["--enable-logging=stderr", "--window-size=1280,1000", f"--virtual-time-budget={wait_ms}"]
    done = subprocess.run([*words, "--dump-dom", address], capture_output=True, text=True, timeout=240)
    said = [line for line in done.stderr.splitlines() if re.search(r"CONSOLE.*\b(Uncaught|Error|Refused|Failed)", line)]
    assert not said and "</html>" in done.stdout, "\n".join(said) or done.stderr[-2000:]
    return done.stdout
