"""Leave nothing of torch's compiler behind, which is loaded with torch's optimizers.

It makes a folder in the temporary one as soon as it is loaded, for what it will compile; the
package has it compile nothing.
"""

from __future__ import annotations

import atexit
import os
from contextlib import suppress
from functools import cache

_FOLDER = "TORCHINDUCTOR_CACHE_DIR"
"""Environment variable that the compiler sets to that folder, where its user has not."""


@cache
def leave_no_folder() -> None:
    """Have the compiler's folder removed at the end of the process; call it before it is loaded."""
    if _FOLDER not in os.environ:
        atexit.register(_remove_empty_folder)


def _remove_empty_folder() -> None:
    with suppress(KeyError, OSError):  # it was not loaded, or has been used
        os.rmdir(os.environ[_FOLDER])
