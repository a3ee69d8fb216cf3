"""Serves the policy of a factory by openpi's websocket protocol, for `foreign.server`: see docs/foreign.md.

    PYTHONPATH=. python examples/foreign/serve.py examples.foreign.hold:make [--options '{"steps": 8}']

Runs where the policy does, in an environment of its own: it needs this repository in PYTHONPATH, numpy,
msgpack and websockets, and nothing else of it. Each connection has a policy to itself.
"""

import argparse
import json
import traceback

import numpy as np

try:
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import ServerConnection, serve
except ModuleNotFoundError:
    raise SystemExit("websockets is not installed; run: pip install websockets msgpack") from None

from rf_exp.policy import make_policy, pack, unpack


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("factory", help="package.module:function")
    parser.add_argument("--options", type=json.loads, default={}, help="its keyword arguments, as JSON")
    parser.add_argument("--host", default="127.0.0.1", help="0.0.0.0 to be reached from other machines")
    parser.add_argument("--port", type=int, default=8000)
    given = parser.parse_args()

    def converse(socket: ServerConnection) -> None:
        try:
            policy = make_policy(given.factory, given.options)
            socket.send(pack({"factory": given.factory}))
            for message in socket:
                observation = unpack(message)  # pyright: ignore[reportArgumentType]
                seed = observation.pop("reset", None)
                if seed is not None and hasattr(policy, "reset"):
                    policy.reset(seed)
                socket.send(pack({"actions": np.asarray(policy.act(observation))}))
        except ConnectionClosed:
            pass  # by a worker that has ended
        except Exception:
            traceback.print_exc()
            socket.send(traceback.format_exc())  # as openpi tells of an error
            socket.close(1011)

    make_policy(given.factory, given.options)  # what is slow or wrong about it shows before anybody waits
    options = {"max_size": None, "compression": None, "ping_interval": None}
    with serve(converse, given.host, given.port, **options) as server:
        print(f"{given.factory} at ws://{given.host}:{server.socket.getsockname()[1]}", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
