"""``.npy`` files of pickled dictionaries, the way of several datasets; reading one runs whatever code it carries."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError

_PROTOCOL = 3
"""The last in which a pickle names modules in plain text, which `save_objects` relies on."""


def save_objects(path: Path, value: Any) -> None:
    """Write one object, or a list of them as a one-dimensional array, as `numpy.save` does.

    Numpy 2 pickles arrays under a module name that numpy before 1.26 does not have; the name that all versions have is
    written instead, since the tools that read these files run on old ones.
    """
    array = np.empty((len(value),) if isinstance(value, list) else (), dtype=object)
    array[...] = value
    data = pickle.dumps(array, protocol=_PROTOCOL).replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n")
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(data)


def load_objects(path: Path) -> Any:
    """Read the array of objects; only for files whose source is trusted.

    Raises:
        FileFormatError: it is truncated or no such file.
    """
    array_shape(path)
    try:
        return np.load(path, allow_pickle=True)
    except (
        pickle.UnpicklingError,
        ArithmeticError,
        AttributeError,
        EOFError,
        ImportError,
        LookupError,
        MemoryError,
        TypeError,
        ValueError,
    ) as error:
        raise FileFormatError(f"its pickled objects are damaged ({' '.join(str(error).split())})") from error


def array_shape(path: Path) -> tuple[int, ...]:
    """Read the shape of an array of objects from its header, which unpickles nothing.

    Raises:
        FileFormatError: it is not an ``.npy`` file, or one of plain numbers.
    """
    try:
        with path.open("rb") as file:
            major, _ = np.lib.format.read_magic(file)
            read_header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
            shape, _, dtype = read_header(file)
    except (ValueError, EOFError, SyntaxError, TypeError) as error:
        raise FileFormatError(f"{path.name} is not an .npy file ({' '.join(str(error).split())})") from error
    if not dtype.hasobject:
        raise FileFormatError(f"{path.name} is an array of {dtype}, not of dictionaries")
    return tuple(shape)
