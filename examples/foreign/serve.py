"""Serves the policy of a factory by openpi's websocket protocol, for `foreign.server`: see docs/foreign.md.

    PYTHONPATH=. python examples/foreign/serve.py examples.foreign.hold:make [--options '{"steps": 8}']

Runs in the Python environment of the policy, which needs this repository in PYTHONPATH, numpy, msgpack,
websockets and lazy_loader. Each connection has a policy of its own.
"""

import argparse
import json
from typing import Any

try:
    from rf_exp.client import serving
except ModuleNotFoundError as error:
    raise SystemExit(f"{error.name} is not installed; run: pip install websockets msgpack") from None

from rf_exp.policy import make_policy


class Served:
    """Adapter from a policy with `act` to the server's interface; `reset` gets the seed of each episode."""

    def __init__(self, factory: str, options: dict[str, Any]) -> None:
        self._policy = make_policy(factory, options)

    def reset(self, seed: int) -> None:
        if hasattr(self._policy, "reset"):
            self._policy.reset(seed)

    def infer(self, observation: dict[str, Any]) -> dict[str, Any]:
        return {"actions": self._policy.act(observation)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("factory", help="package.module:function")
    parser.add_argument("--options", type=json.loads, default={}, help="its keyword arguments, as JSON")
    parser.add_argument("--host", default="127.0.0.1", help="0.0.0.0 to be reached from other machines")
    parser.add_argument("--port", type=int, default=8000)
    args = parser.parse_args()

    def make() -> Served:
        return Served(args.factory, args.options)

    make()  # errors and slow loading show before the first connection
    with serving(make, args.host, args.port, {"factory": args.factory}) as server:
        print(f"{args.factory} at {server.address}", flush=True)
        server.run()


if __name__ == "__main__":
    main()
