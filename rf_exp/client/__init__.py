"""Client: the part of the suite that a policy server needs, with numpy, msgpack and websockets.

The distribution `rf_exp-client` packages these files as `rf_exp_client` (plugins/rf_exp_client), so they
import each other and `texts` by relative names. The wire format and the contract of observations and actions
are defined only here: see docs/serving.md. Modules that need msgpack or websockets are imported lazily: the
suite checks actions without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .checking import Report, check
    from .connection import Connection, ServerFailed
    from .contract import Contract, Entry, validate_chunk
    from .server import Policy, Server, serve, serving
    from .wire import pack, unpack

__all__ = [
    "Connection",
    "Contract",
    "Entry",
    "Policy",
    "Report",
    "Server",
    "ServerFailed",
    "check",
    "pack",
    "serve",
    "serving",
    "unpack",
    "validate_chunk",
]

_MODULES = {
    "checking": ("Report", "check"),
    "connection": ("Connection", "ServerFailed"),
    "contract": ("Contract", "Entry", "validate_chunk"),
    "server": ("Policy", "Server", "serve", "serving"),
    "wire": ("pack", "unpack"),
}


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
