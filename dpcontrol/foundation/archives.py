"""Files of arrays with a JSON header (NumPy's .npz), read so that whatever is wrong with one is said in a sentence.

Format: NumPy Enhancement Proposal 1, a zip archive of .npy files; `header` is a string of JSON among them.
"""

import json
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from dpcontrol.foundation.errors import InputError


@contextmanager
def archive(path: Path | IO[bytes], *, what: str, make: str, again: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Yield the header and the arrays of `path`, a path or an open binary file; what the block trips over is damage.

    what: the archive's kind with its article; make: how one is made; again: the same of a damaged one.

    Raises:
        InputError: there is no such file, or it is damaged or of another kind; says which.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        yield json.loads(str(arrays.pop("header"))), arrays
    except FileNotFoundError as error:
        raise InputError(f"there is no {what.partition(' ')[2]} {path}; {make}") from error
    except (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        EOFError,
        IndexError,
        InputError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        # What is no archive at all numpy takes for pickled data, and advises to trust it.
        reason = "it is no .npz file" if "pickle" in reason else reason
        raise InputError(f"{path} is not {what} of dpcontrol, or is damaged: {reason}; {again}") from error
