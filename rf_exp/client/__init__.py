"""Client: what the machine that serves a policy needs of the suite, with numpy, msgpack and websockets.

The distribution `rf_exp-client` packages these very files as `rf_exp_client` (plugins/rf_exp_client), so they
import one another, and `texts`, by relative names. The wire format and the contract of observations and
actions are written here and nowhere else: see docs/serving.md. What needs msgpack or websockets is imported
once it is asked for: the suite judges actions without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .checking import Report, check
    from .connection import Connection, ServerFailed
    from .contract import Contract, Entry, checked
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
    "checked",
    "pack",
    "serve",
    "serving",
    "unpack",
]

_MODULES = {
    "checking": ("Report", "check"),
    "connection": ("Connection", "ServerFailed"),
    "contract": ("Contract", "Entry", "checked"),
    "server": ("Policy", "Server", "serve", "serving"),
    "wire": ("pack", "unpack"),
}


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
