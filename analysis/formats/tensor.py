r"""Mitsuba's tensor files: named arrays, little-endian, every size checked before anything is read.

    tensor_file\0  version (2 bytes: 1, 0)  number of fields (u32), then for each field
    length of the name (u16)  name  dimensions (u16)  type (u8)  offset (u64)  shape (u64 each)

and the arrays at their offsets.
"""

from __future__ import annotations

import math
import struct
from io import BytesIO
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import BinaryIO

    from numpy.typing import NDArray

    Tensors = dict[str, NDArray[Any]]

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
TYPES = {
    1: "|u1", 2: "|i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4",
    11: "<f8",
}  # fmt: skip
"""Number of a type in the file, and numpy's name of it."""

LARGEST_BYTES = 512 * 1024**2
MOST_FIELDS = 256
MOST_DIMENSIONS = 8
LONGEST_NAME = 255
ALIGNMENT = 8


class _Field(NamedTuple):
    name: str
    kind: str
    offset: int
    shape: tuple[int, ...]


def read_tensors(path: Path) -> Tensors:
    """Read all arrays of a tensor file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict of str to ndarray
        In the file's order; each array owns its memory.

    Raises
    ------
    BadInput
        If the file is no tensor file, of another version, or a field does not lie inside it.
    """
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise BadInput(f"is {size / 1024**2:.0f} MB, more than gonio reads", where=str(path))
    return unpack_tensors(path.read_bytes(), str(path))


def unpack_tensors(content: bytes, where: str) -> Tensors:
    """Read all arrays from a tensor file's bytes; see `read_tensors`, `where` names them in errors."""
    stream = BytesIO(content)
    fields = _read_header(stream, len(content), where)
    return {field.name: _read_array(stream, field) for field in fields}


def write_tensors(path: Path, tensors: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as a tensor file; see `pack_tensors`."""
    path.write_bytes(pack_tensors(tensors))


def pack_tensors(tensors: Mapping[str, NDArray[Any]]) -> bytes:
    """Give the bytes of a tensor file.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        Arrays of one of the types of `TYPES`.

    Raises
    ------
    BadInput
        If an array has a type that the format does not know.
    """
    numbers = {name: number for number, name in TYPES.items()}
    arrays = {
        name: np.ascontiguousarray(array, array.dtype.newbyteorder("<")) for name, array in tensors.items()
    }
    heads = {name: _head(name, array) for name, array in arrays.items()}
    place = len(MAGIC) + 6 + sum(len(first) + 9 + len(shape) for first, shape in heads.values())
    header, body = [MAGIC, bytes(VERSION), struct.pack("<I", len(arrays))], []
    for name, array in arrays.items():
        kind = array.dtype.str
        if kind not in numbers:
            raise BadInput(f"type {array.dtype} is not one of the tensor format", where=name)
        padding = -place % ALIGNMENT
        first, shape = heads[name]
        header += [first, struct.pack("<BQ", numbers[kind], place + padding), shape]
        body += [bytes(padding), array.tobytes()]
        place += padding + array.nbytes
    return b"".join(header + body)


def _head(name: str, array: NDArray[Any]) -> tuple[bytes, bytes]:
    """Return what stands before and behind the type and the offset in a field's entry."""
    encoded = name.encode()
    return (
        struct.pack("<H", len(encoded)) + encoded + struct.pack("<H", array.ndim),
        struct.pack(f"<{array.ndim}Q", *array.shape),
    )


def _read_header(stream: BinaryIO, size: int, where: str) -> list[_Field]:
    if stream.read(len(MAGIC)) != MAGIC:
        raise BadInput("is no tensor file", where=where, todo="check what the file is")
    version = _unpack(stream, "<BB", f"{where}: version")
    if version != VERSION:
        raise BadInput(
            f"is of version {version[0]}.{version[1]}, gonio reads {VERSION[0]}.{VERSION[1]}", where=where
        )
    (count,) = _unpack(stream, "<I", f"{where}: number of fields")
    if not 1 <= count <= MOST_FIELDS:
        raise BadInput(
            f"announces {count} fields", where=f"{where}: byte 14", todo="copy it again; is it big-endian?"
        )
    fields = [_read_field(stream, size, f"{where}: field {index + 1}") for index in range(count)]
    names = [field.name for field in fields]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise BadInput("stands twice in the file", where=f"{where}: {twice[0]}")
    return fields


def _read_field(stream: BinaryIO, size: int, where: str) -> _Field:
    (length,) = _unpack(stream, "<H", where)
    if not 1 <= length <= LONGEST_NAME:
        raise BadInput(f"has a name of {length} bytes", where=where, todo="copy the file again")
    raw = stream.read(length)
    name = raw.decode("ascii", errors="replace")
    if len(raw) < length or not name.isprintable() or not name.isascii():
        raise BadInput("has no readable name", where=where, todo="copy the file again")
    where = f"{where} ({name})"
    dimensions, number, offset = _unpack(stream, "<HBQ", where)
    if dimensions > MOST_DIMENSIONS or number not in TYPES:
        raise BadInput(
            f"has {dimensions} dimensions of type {number}", where=where, todo="copy the file again"
        )
    shape = _unpack(stream, f"<{dimensions}Q", where)
    end = offset + math.prod(shape) * np.dtype(TYPES[number]).itemsize
    # A shape with a zero could hide any other size: numpy refuses some of those.
    if end > size or 0 in shape:
        raise BadInput(
            f"{' x '.join(map(str, shape))} values at byte {offset} do not lie inside its {size} bytes",
            where=where,
            todo="the file is cut short or damaged: copy it again",
        )
    return _Field(name, TYPES[number], offset, shape)


def _read_array(stream: BinaryIO, field: _Field) -> NDArray[Any]:
    stream.seek(field.offset)
    count = math.prod(field.shape)
    kind = np.dtype(field.kind)
    return np.frombuffer(stream.read(count * kind.itemsize), kind).reshape(field.shape).copy()


def _unpack(stream: BinaryIO, layout: str, where: str) -> tuple[int, ...]:
    content = stream.read(struct.calcsize(layout))
    if len(content) < struct.calcsize(layout):
        raise BadInput("the file ends here", where=where, todo="it is cut short: copy it again")
    return struct.unpack(layout, content)
