"""Protection of API keys: they stay in the environment and never reach a file, a log or a recording."""

import re
from collections.abc import Collection, Sequence
from urllib.parse import urlsplit

from rf_exp.errors import ArgumentError

MIN_SECRET_LENGTH = (
    8  # characters; shorter values ("none", "EMPTY") are no secrets, but masking them garbles texts
)
SECRET_NAMES = ("api_key", "key", "token", "password")  # names under which users might write a secret
_KEY = re.compile(r"([\w-]+)['\"]?\s*:")  # a key of a mapping on the command line
_ENVIRONMENT_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,63}")


def mask_key(text: str, key: str) -> str:
    """The text with the key masked; servers repeat it in their errors."""
    return text.replace(key, "[key]") if len(key) >= MIN_SECRET_LENGTH else text


def check_environment_name(name: str) -> None:
    """Raises ArgumentError for a value that may be a key instead of a name, without repeating it."""
    if _ENVIRONMENT_NAME.fullmatch(name) is None:
        raise ArgumentError(
            "brain.api_key_env is not the name of an environment variable (capitals, digits, underscores). "
            "Put the key into a variable, OPENAI_API_KEY say, and give its name; never the key itself"
        )


def check_address(url: str) -> str:
    """The http(s) address. Raises ArgumentError for another kind, or one that holds secrets."""
    forbidden = (
        "a user, a password or a query; addresses are recorded, so put the key into the environment variable "
        "that brain.api_key_env names"
    )
    example = "an example: http://localhost:8000/v1"
    return _checked_url(url, ("http", "https"), "the address of the model's server", forbidden, example)


def check_policy_server(url: str) -> str:
    """The ws(s) address. Raises ArgumentError for another kind, or one that holds secrets."""
    expected = (
        "expected ws://host:port or wss://host:port, without user, password and query, as it is recorded"
    )
    return _checked_url(url, ("ws", "wss"), "foreign.server", f"more than an address; {expected}", expected)


def _checked_url(url: str, schemes: Collection[str], label: str, forbidden: str, expected: str) -> str:
    try:
        parts = urlsplit(url)
        usable = parts.scheme in schemes and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        raise ArgumentError(f"{label} cannot be read; {expected}") from None
    if parts.username or parts.password or parts.query or parts.fragment:
        raise ArgumentError(f"{label} holds {forbidden}")
    if not usable:
        raise ArgumentError(f"{label} is {url!r}; {expected}")
    return url


def refuse_keys(arguments: Sequence[str]) -> None:
    """Raises ArgumentError for arguments with a key, before Hydra writes them below `outputs/runs/`."""
    for argument in arguments:
        name, _, value = argument.lstrip("+~").partition("=")
        last_part = name.rsplit(".", 1)[-1].rsplit("/", 1)[-1].lower()
        value = value.strip("'\"")
        nested = [each.lower() for each in _KEY.findall(value)] if "extra_body" in name else []
        for secret in (each for each in (last_part, *nested) if each in SECRET_NAMES):
            raise key_in_config_error(secret)
        if last_part == "api_key_env":
            check_environment_name(value)
        if last_part == "base_url" and value not in ("", "null"):
            check_address(value)
        if name == "foreign.server" and value not in ("", "null"):
            check_policy_server(value)


def key_in_config_error(name: str) -> ArgumentError:
    """The error for a key in the configuration, which is written to files."""
    return ArgumentError(
        f"brain.{name} is not taken: configurations are written below outputs/. Put the key into an "
        "environment variable and give its name: brain.api_key_env=OPENAI_API_KEY"
    )
