"""Reader of `.ckpt` files by PyTorch's `torch.save`: tensors and plain values; none of their code runs.

Such a file is a ZIP archive: `data.pkl`, a pickle of what was saved, and the bytes of each tensor in a file
of its own. A pickle names functions and calls them, which could be any. Here it may only name what a
checkpoint of Diffusion Policy consists of, with an inert stand-in for each: nothing is imported.
"""

import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from rf_exp.errors import ArgumentError, StageError
from rf_exp.store import translate_decoder_errors
from rf_exp.texts import printable

LARGEST_PICKLE = 2**26  # bytes
DTYPES = {
    "FloatStorage": torch.float32,
    "DoubleStorage": torch.float64,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}


@dataclass(frozen=True)
class StoredTensor:
    """A tensor whose values have not been read."""

    key: str  # name of its file
    dtype: torch.dtype
    items: int  # number of values in its file
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]


class Checkpoint:
    """Contents of one file: `contents`, plain values and `StoredTensor`s, which `tensor` reads."""

    def __init__(self, path: Path) -> None:
        """Raises ArgumentError for files of another kind or that name code, StageError for damaged ones."""
        if not path.is_file():
            raise ArgumentError(f"there is no file {path}; expected a .ckpt")
        self.path = path
        with self._error_context():
            if not zipfile.is_zipfile(path):
                raise ArgumentError(
                    f"{path} is no checkpoint: expected the ZIP archive that torch.save writes"
                )
            self._archive = zipfile.ZipFile(path)
            names = self._archive.namelist()
            pickles = [name for name in names if name.endswith("/data.pkl")]
            if len(pickles) != 1:
                raise ArgumentError(f"{path} is no checkpoint: it has {len(pickles)} data.pkl; expected one")
            self._folder = pickles[0].removesuffix("data.pkl")
            order = f"{self._folder}byteorder"
            if order in names and self._bytes(order) != b"little":
                raise ArgumentError(f"{path} was written with the high byte first; expected little-endian")
            if (size := self._archive.getinfo(pickles[0]).file_size) > LARGEST_PICKLE:
                raise ArgumentError(f"{path}: its pickle has {size} bytes; expected at most {LARGEST_PICKLE}")
            self.contents = plain(_RestrictedUnpickler(path, self._bytes(pickles[0])).load())

    def tensor(self, stored: StoredTensor) -> Tensor:
        """The values of a tensor. Raises StageError where the file lacks some of them."""
        with self._error_context():
            data = bytearray(self._bytes(f"{self._folder}data/{stored.key}"))
            if len(data) != stored.items * stored.dtype.itemsize:
                raise ValueError(f"storage {stored.key!r} has {len(data)} bytes, not {stored.items} numbers")
            flat = torch.frombuffer(data, dtype=stored.dtype) if data else torch.empty(0, dtype=stored.dtype)
            return flat.as_strided(stored.size, stored.stride, stored.offset).contiguous()

    def _bytes(self, name: str) -> bytes:
        """A file of the archive; it must be uncompressed, so that it is no larger than the archive."""
        entry = self._archive.getinfo(name)
        if entry.compress_type != zipfile.ZIP_STORED:
            raise ArgumentError(f"{self.path} is no checkpoint: {printable(name)} in it is compressed")
        return self._archive.read(name)

    def _error_context(self) -> AbstractContextManager[None]:
        return translate_decoder_errors(self.path, lambda why: StageError(f"{self.path} is damaged {why}"))


def plain(value: Any, converted: dict[int, Any] | None = None) -> Any:
    """Saved values, with OmegaConf's nodes replaced by the mappings, lists and values that they hold."""
    converted = {} if converted is None else converted  # shared objects are converted once
    if id(value) not in converted:
        if isinstance(value, _StandIn):
            result = plain(vars(value).get("_content", vars(value).get("_val")), converted)
        elif isinstance(value, Mapping):
            result = {key: plain(item, converted) for key, item in value.items()}
        else:
            result = [plain(item, converted) for item in value] if isinstance(value, list | tuple) else value
        converted[id(value)] = result
    return converted[id(value)]


class _StandIn:
    """Stand-in for an object of a class that is not imported: its state, without constructor arguments."""

    def __new__(cls, *_: object) -> "_StandIn":
        return super().__new__(cls)

    def __init__(self, *_: object) -> None:
        pass


def _rebuilt_tensor(
    storage: tuple[torch.dtype, str, int], offset: Any, size: Any, stride: Any, *_: object
) -> StoredTensor:
    dtype, key, items = storage
    numbers = [items, offset, *size, *stride]
    valid = isinstance(key, str) and all(isinstance(number, int) and number >= 0 for number in numbers)
    if not valid or prod(size) > items:
        raise ValueError(f"a tensor of size {size} and stride {stride} at {offset} of {items} numbers")
    return StoredTensor(key, dtype, items, offset, tuple(size), tuple(stride))


# Names that a file may use, and their stand-ins.
_PLAIN_TYPES = ("dict", "list", "tuple", "set", "int", "long", "float", "str", "bool", "bytes")
_OMEGACONF_NODES = ("Any", "Integer", "Float", "Boolean", "String")
_STAND_INS: dict[tuple[str, str], Any] = {
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): lambda *_: {},  # empty, without its default factory
    ("typing", "Any"): _StandIn,
    ("_codecs", "encode"): lambda text, _: text.encode("latin1"),  # bytes in the oldest pickles
    **{("torch", name): type(name, (_StandIn,), {"dtype": dtype}) for name, dtype in DTYPES.items()},
    ("torch._utils", "_rebuild_tensor_v2"): _rebuilt_tensor,
    ("torch._utils", "_rebuild_parameter"): lambda data, *_: data,
    ("omegaconf.dictconfig", "DictConfig"): _StandIn,
    ("omegaconf.listconfig", "ListConfig"): _StandIn,
    ("omegaconf.base", "Metadata"): _StandIn,
    ("omegaconf.base", "ContainerMetadata"): _StandIn,
    **{("omegaconf.nodes", f"{kind}Node"): _StandIn for kind in _OMEGACONF_NODES},
    **{(module, "_load_type"): _StandIn for module in ("dill._dill", "dill.dill")},  # how dill names a type
    **{(module, kind): _StandIn for module in ("builtins", "__builtin__") for kind in _PLAIN_TYPES},
}


class _RestrictedUnpickler(pickle.Unpickler):
    """Unpickler that resolves the names in `_STAND_INS` alone."""

    def __init__(self, path: Path, data: bytes) -> None:
        super().__init__(BytesIO(data))
        self._path = path

    def find_class(self, module_name: str, global_name: str) -> Any:
        """The stand-in for a name. Raises ArgumentError for unknown names: they would be code."""
        if (stand_in := _STAND_INS.get((module_name, global_name))) is None:
            name = printable(f"{module_name}.{global_name}", 200)
            raise ArgumentError(
                f"{self._path} names {name}, which is code that would run if the file were unpickled; it was "
                "not run: expected tensors and plain values alone, as Diffusion Policy saves them"
            )
        return stand_in

    def persistent_load(self, pid: Any) -> Any:
        """Storage of a tensor: dtype, file and number of values."""
        _, kind, key, _, items = pid
        return kind.dtype, key, items
