"""``--pdf`` prints a page into a PDF by a browser, since its figures are
drawn by one.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from dextar_control.contract.errors import DextarError

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "brave-browser",
)
# px of the page as it is drawn: what is wider than the paper less its margins is cut
# off
WIDTH = 760
PATIENCE = 120.0  # s


class PdfError(DextarError):
    """A page cannot be printed."""


def find_browser() -> str | None:
    """Return the first browser of Chromium's kind on the PATH; None without one."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


class _Pdf(argparse.Action):
    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *_: object
    ) -> None:
        if find_browser() is None:
            parser.error(
                "--pdf needs Chromium or Chrome, and none is on the PATH: install one"
                " (apt install chromium), or open the page in any browser and print it"
                " from there"
            )
        namespace.pdf = True


def add_pdf(parser: argparse.ArgumentParser, page: str) -> None:
    """Add ``--pdf`` to a command that writes a page; it is refused at once where there
    is no browser.
    """
    parser.add_argument(
        "--pdf",
        action=_Pdf,
        nargs=0,
        default=False,
        help=f"also print {page} into a PDF beside it, by Chromium",
    )


def write_pdf(page: Path) -> Path:
    """Print a page into a PDF beside it; return the PDF's path.

    Raises:
        PdfError: there is no browser, or it fails.
    """
    browser, target = find_browser(), page.with_suffix(".pdf").resolve()
    if browser is None:
        raise PdfError(
            f"{page} cannot be printed: neither Chromium nor Chrome is on the PATH"
        )
    target.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(prefix="dextar_pdf_") as profile:
        command = [
            browser,
            "--headless",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--no-pdf-header-footer",
            *(["--no-sandbox"] if os.geteuid() == 0 else []),
            f"--user-data-dir={profile}",
            f"--window-size={WIDTH},1000",
            "--virtual-time-budget=20000",
            f"--print-to-pdf={target}",
            page.resolve().as_uri(),
        ]
        try:
            answer = subprocess.run(
                command,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=PATIENCE,
                check=False,
            )
            said = answer.stderr.strip().splitlines()
        except (OSError, subprocess.TimeoutExpired) as error:
            said = [str(error)]
    if not target.is_file():
        raise PdfError(
            f"{page} cannot be printed by {browser}:"
            f" {said[-1] if said else 'it said nothing'}"
        )
    return target
