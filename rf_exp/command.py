"""Common frame of all commands: composing their configuration, exit codes, and messages about errors."""

import functools
import os
import re
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import MarkedYAMLError

from rf_exp.artifacts import disk_full
from rf_exp.errors import ArgumentError, RfError, StageError
from rf_exp.installed import CONF
from rf_exp.keys import checked_arguments, checked_folder, keys_help, refuse_unknown_keys, unknown_key_message
from rf_exp.processes import SHELL_SIGNAL, end_with_parent
from rf_exp.progress import error_console
from rf_exp.secrets import refuse_keys
from rf_exp.texts import LONGEST_ERROR, one_line, shown

FULL_ERROR = "HYDRA_FULL_ERROR"  # set to 1 by users to see tracebacks
SPARE_BYTES = 2**24  # reserved, and freed when memory runs out, so that the error can still be reported
ARGUMENT_ERRORS = (ArgumentError, HydraException, OmegaConfBaseException)
OUT_OF_MEMORY = (  # parts of the messages of libraries and the system
    *("can't allocate memory", "out of memory", "not enough memory", "Cannot allocate memory"),
    *("OutOfDeviceMemory", "OutOfHostMemory", "std::bad_alloc"),
    *("failed to map segment from shared object", "can't start new thread"),
)
# `out` is checked before Hydra makes the folder of its logs.
OmegaConf.register_new_resolver("folder", checked_folder, replace=True)
OmegaConf.register_new_resolver("file_name", lambda choice: PurePosixPath(choice).name, replace=True)
OmegaConf.register_new_resolver("keys_help", keys_help, replace=True)


def register_all_tasks() -> None:
    """Registers `task=all` as all files of conf/task, so that no list is edited, and families as tasks."""
    store = ConfigStore.instance()
    names = sorted(path.stem for path in (CONF / "task").glob("*.yaml"))
    store.store(group="task", name="all", node={"defaults": names})
    for path in (CONF / "task" / "family").glob("*.yaml"):
        store.store(group="task", name=path.stem, node={"defaults": [f"family/{path.stem}"]})


class _SignalReceived(KeyboardInterrupt):
    """Raised on a signal (its argument) that ends the command."""


def run_guarded(job: Callable[[], None]) -> int:
    """Runs `job`; exit code: 0 done, 1 a stage failed, 2 a wrong argument, 130 Ctrl-C, 143 SIGTERM.

    Prints an error as one line. HYDRA_FULL_ERROR=1 shows the traceback as well.
    """
    full_error = os.environ.get(FULL_ERROR)
    spare = bytearray(SPARE_BYTES)
    # Otherwise Hydra would print every error itself and exit with 1.
    os.environ[FULL_ERROR] = "1"
    try:
        with _signals_end_command():
            refuse_keys(sys.argv[1:])  # before Hydra writes them to a file
            sys.argv[1:] = _expand_release(sys.argv[1:])
            try:
                job()
            finally:  # Hydra raises SystemExit after --help
                sys.stdout.flush()
    except _SignalReceived as received:
        (number,) = received.args
        error_console.print(f"ended by {number.name}; the same command goes on from here")
        return SHELL_SIGNAL + number
    except KeyboardInterrupt:
        error_console.print("interrupted; the same command goes on from here")
        return SHELL_SIGNAL + signal.SIGINT
    except BrokenPipeError:  # as in `rf-exp --help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes the rest there
        error_console.print("ended: output pipe closed; the same command goes on from here")
        return SHELL_SIGNAL + signal.SIGPIPE
    except Exception as error:
        del spare
        if full_error == "1":
            error_console.print("".join(traceback.format_exception(error)), end="")
        code, message = _exit_code_and_message(error)
        error_console.print(shown(message, LONGEST_ERROR))
        return code
    finally:
        os.environ.pop(FULL_ERROR)
        if full_error is not None:
            os.environ[FULL_ERROR] = full_error
    return 0


def _expand_release(arguments: list[str]) -> list[str]:
    if not any("released" in argument for argument in arguments):
        return arguments  # help and a wrong argument are answered without torch
    from rf_exp.release import expand_release

    return expand_release(arguments)


def to_plain_config(config: DictConfig) -> dict[str, Any]:
    """The composed configuration as plain values.

    Raises ArgumentError for a task whose texts are interpolated, for example from the environment: they are
    published.
    """
    from rf_exp.tasks import check_texts  # also imports the objects, which --help does not need

    if isinstance(tasks := config.get("task"), DictConfig):
        for name, task in tasks.items_ex(resolve=False):
            check_texts(str(name), OmegaConf.to_container(task) if OmegaConf.is_config(task) else task)
    node: Any = OmegaConf.to_container(config, resolve=True)
    return node


def hydra_command(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Decorator of a command's main function: Hydra composes its configuration from `conf/` and arguments."""

    def decorate(main: Callable[[DictConfig], None]) -> Callable[[], None]:
        hydra_main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)

        @functools.wraps(main)
        def run() -> None:
            register_all_tasks()
            sys.argv[1:] = checked_arguments(sys.argv[1:])
            try:
                hydra_main(wrap_unexpected_errors(main))()
            except OSError as error:  # from Hydra, which makes its folder, not from the job
                if error.filename is None or disk_full(error):
                    raise
                why = f"cannot make {error.filename}: {error.strerror}; choose another folder with out=FOLDER"
                raise ArgumentError(one_line(why, LONGEST_ERROR)) from error

        return run

    return decorate


def wrap_unexpected_errors(main: Callable[[DictConfig], None]) -> Callable[[DictConfig], Any]:
    """Decorator of the function below `hydra.main`: turns unexpected errors into a StageError and a log file.

    A job that a launcher has put into a process of its own ends with the command.
    """

    @functools.wraps(main)
    def run(config: DictConfig) -> None:
        end_with_parent()
        try:
            if (policy := config.get("policy")) is not None:
                from rf_exp.policy import import_code  # imports torch only if that module does

                import_code(policy)
            refuse_unknown_keys(config)
            main(config)
        except (*ARGUMENT_ERRORS, RfError, BrokenPipeError):
            raise
        except Exception as error:
            raise _unexpected_error(error, Path(HydraConfig.get().runtime.output_dir)) from error

    return run


def _exit_code_and_message(error: Exception) -> tuple[int, str]:
    """Exit code and last line of output for an error that reached the command."""
    if isinstance(error, ARGUMENT_ERRORS):
        return 2, f"wrong argument: {_clear_message(error)}"
    if isinstance(error, MarkedYAMLError) and (mark := error.problem_mark) is not None:
        place = one_line(f"{mark.name}, line {mark.line + 1}: {error.problem}", LONGEST_ERROR)
        return 2, f"wrong argument: {place}; it is no YAML"
    if isinstance(error, OSError) and error.filename is not None and not disk_full(error):
        why = one_line(f"{error.filename}: {error.strerror}", LONGEST_ERROR)
        return 2, f"wrong argument: {why}"
    if not isinstance(error, RfError):
        error = _unexpected_error(error, Path(tempfile.mkdtemp(prefix="rf_exp-")))
    return 1, f"failed: {error}"


def _clear_message(error: Exception) -> str:
    """The message about a wrong argument; replaces messages of Hydra and OmegaConf that mislead."""
    if match := re.match(r"Could not override '([^']+)'", str(error)):  # unknown key
        return unknown_key_message(match[1])
    if "interpolation '${variation}'" in str(error):
        return "variation is no single name; say one of conf/variation, or -m variation=ONE,OTHER: a job each"
    if match := re.match(r"Multiple values for (\S+)\. To override", str(error)):
        return f"{match[1]} is chosen already; choose another one with {match[1]}=NAME, without +"
    if match := re.search(r"Could not find '(\w+)/(\w+)'", str(error)):  # perhaps in a subfolder of its group
        group, name = match.groups()
        files = (path.relative_to(CONF).with_suffix("") for path in (CONF / group).glob(f"*/{name}.yaml"))
        if meant := [f"{group}={path.relative_to(group).as_posix()}" for path in files]:
            return f"there is no {group}={name}; did you mean {' or '.join(sorted(meant))}?"
    if not isinstance(error, OmegaConfBaseException):
        return str(error)
    message = _first_line(error)  # further lines hold the location
    own = re.match(r"ArgumentError raised while resolving interpolation: (.+)", message)
    return own[1] if own else f"{error.full_key}: {message}" if error.full_key else message


def _unexpected_error(error: Exception, folder: Path) -> StageError:
    """One line for an unexpected error, whose traceback is written to a file."""
    if isinstance(error, MemoryError) or any(part in str(error) for part in OUT_OF_MEMORY):
        return StageError(
            f"memory ran out ({_first_line(error)}); fewer workers, smaller pictures or a smaller "
            "batch_size need less; the same command goes on from here"
        )
    if disk_full(error):
        return StageError(
            f"disk full ({_first_line(error)}); free some space, finished work is intact; the "
            "same command goes on from here"
        )
    path = folder / "error.log"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(shown("".join(traceback.format_exception(error))), "utf-8")
        where = f"the traceback is in {path}"
    except OSError:
        where = f"{FULL_ERROR}=1 shows the traceback"
    return StageError(f"unexpected {type(error).__name__}: {_first_line(error)}; {where}")


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or ["without a message"])[0]


@contextmanager
def _signals_end_command() -> Iterator[None]:
    """Context in which SIGTERM and SIGHUP end the command as Ctrl-C does, a second signal at once."""

    def on_signal(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise _SignalReceived(signal.Signals(number))

    ending = signal.SIGTERM, signal.SIGHUP
    numbers = [number for number in ending if signal.getsignal(number) is signal.SIG_DFL]  # not below nohup
    for number in numbers:
        signal.signal(number, on_signal)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
