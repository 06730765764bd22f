"""Where Numba keeps compiled kernels, where neither the installation nor a home folder can be written: in containers, say.

Numba looks in the folder of the source and in the user's cache, and raises where it may write to neither.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
_PACKAGE = Path(__file__).parent


def provide_cache() -> None:
    """Names a folder for temporary files instead, or none, and says so once: processes that are started later inherit it."""
    if os.environ.get(VARIABLE) or _is_writable(_PACKAGE) or _user_cache_is_writable():
        return
    try:
        folder = _temporary()
    except OSError:
        _do_without()
        where = "compiled kernels are not kept"
    else:
        os.environ[VARIABLE] = folder
        if (numba := sys.modules.get("numba")) is not None:  # which has read the variable already
            numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
        where = f"compiled kernels are kept in {folder}"
    sys.stderr.write(f"robocar: neither the installation nor a home folder can be written: {where}; {VARIABLE} names a place\n")


def _is_writable(package: Path) -> bool:
    """The folders of all modules, and what was kept there before."""
    for folder, inner, files in os.walk(package, followlinks=True):
        inner[:] = [name for name in inner if name not in ("models", "__pycache__")]
        kept = os.path.join(folder, "__pycache__")
        if "__init__.py" in files and not os.access(kept if os.path.isdir(kept) else folder, os.W_OK | os.X_OK):
            return False
    return True


def _user_cache_is_writable() -> bool:
    """The one that Numba would take."""
    if sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA") or os.path.expanduser("~"))
    elif sys.platform == "darwin":
        folder = Path(os.path.expanduser("~/Library/Caches"))
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "numba"
    if not folder.is_absolute():  # there is no home at all
        return False
    there = next(parent for parent in (folder, *folder.parents) if parent.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _temporary() -> str:
    """One for all processes of a user. What is kept there is code, so nobody else may have written it.

    Raises:
        OSError: there is no folder for temporary files.
    """
    if not hasattr(os, "getuid"):
        return tempfile.mkdtemp(prefix="robocar-kernels-")
    folder = os.path.join(tempfile.gettempdir(), f"robocar-kernels-{os.getuid()}")
    try:
        os.mkdir(folder, 0o700)
    except FileExistsError:
        found = os.lstat(folder)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
            return tempfile.mkdtemp(prefix="robocar-kernels-")
    return folder


def _do_without() -> None:
    from numba.core.dispatcher import Dispatcher

    Dispatcher.enable_caching = lambda self: None
