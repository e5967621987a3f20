"""Show a page in the user's browser, from a temporary file.

The browser may read the file after this program has ended, and again when the user reloads the
page.  A file is therefore kept for a day at least: writing one removes those that are older.
Browsers packaged as snap or flatpak read neither ``/tmp`` nor hidden folders, but they do read
the folder of downloads.
"""

from __future__ import annotations

import os
import tempfile
import time
import webbrowser
from pathlib import Path

import platformdirs

from multiarm.errors import ReplayError

PREFIX, SUFFIX = "multiarm-replay-", ".tmp.html"
KEPT = 24 * 3600.0  # [s]


def temporary_page(page: str) -> Path:
    """Write a page to a new file that only its owner reads, and remove those of earlier days.

    Raises
    ------
    ReplayError
        The file cannot be written.
    """
    folder = _folder()
    _remove_old_pages(folder)
    path = None
    try:
        descriptor, name = tempfile.mkstemp(SUFFIX, PREFIX, folder)
        path = Path(name)
        with open(descriptor, "w", encoding="utf-8") as file:
            file.write(page)
    except OSError as error:
        if path is not None:
            path.unlink(missing_ok=True)
        raise ReplayError(
            f"cannot write the replay to {path or folder}: {error.strerror or error}; name a file "
            "in another place"
        ) from error
    return path


def open_in_browser(url: str) -> bool:
    """Open a page in the user's browser; False where there is none.

    Without a display, Python would start a browser for terminals, which shows no replay.
    """
    if not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        return False
    return webbrowser.open(url)


def _folder() -> Path:
    downloads = platformdirs.user_downloads_path()
    writable = downloads.is_dir() and os.access(downloads, os.W_OK | os.X_OK)
    return downloads if writable else Path(tempfile.gettempdir())


def _remove_old_pages(folder: Path) -> None:
    for path in folder.glob(f"{PREFIX}*{SUFFIX}"):
        try:
            status = path.lstat()
            if status.st_uid == os.getuid() and status.st_mtime < time.time() - KEPT:
                path.unlink()
        except OSError:  # another replay has just removed it
            continue
