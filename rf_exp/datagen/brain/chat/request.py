"""One request to a server that speaks OpenAI's chat completions.

Whatever goes wrong on the way becomes a BadAnswer, which the generation loop treats like any other
failed proposal. Connections, retries and `Retry-After` are the client's own.
"""

import asyncio
import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rf_exp.datagen.brain.chat.completion import content
from rf_exp.datagen.brain.chat.connection import Connection
from rf_exp.datagen.brain.chat.exchanges import Message
from rf_exp.datagen.brain.reading import BadAnswer, Rejected, Unreached
from rf_exp.texts import printable

if TYPE_CHECKING:
    import openai

_REJECTED = (400, 422, 501)  # statuses of a request that is not understood, or cannot be carried out


async def request(
    connection: Connection, key: str, messages: Sequence[Message], schema: Mapping[str, object]
) -> str:
    """The model's text. The deadline also ends answers that trickle in for ever. Raises BadAnswer.

    The key may be in the text and in the error, where the server repeats it.
    """
    import openai  # half a second; only who asks a model needs it

    from rf_exp.datagen.brain.chat.bodies import connection as bounded

    try:
        async with (
            asyncio.timeout(connection.deadline_s),
            openai.AsyncOpenAI(
                api_key=key,
                base_url=connection.address(),
                timeout=connection.timeout_s,
                max_retries=connection.retries,
                http_client=bounded(),
            ) as client,
        ):
            response = await client.chat.completions.with_raw_response.create(
                model=connection.model,
                messages=[_wire(message) for message in messages],
                max_completion_tokens=connection.max_tokens,
                extra_body=connection.extra_body,
                **_options(connection, schema),
            )
            return content(response.content, response.headers.get("Content-Type", "no type"))
    except TimeoutError:
        raise Unreached(f"the model did not answer within {connection.deadline_s:g} s") from None
    except openai.OpenAIError as error:
        raise _unanswered(error, connection) from None


def _options(connection: Connection, schema: Mapping[str, object]) -> dict[str, Any]:
    """What is sent only where the configuration says so."""
    options: dict[str, Any] = {}
    if connection.structured:
        wanted = {"name": "answer", "schema": schema, "strict": True}
        options["response_format"] = {"type": "json_schema", "json_schema": wanted}
    if connection.temperature is not None:
        options["temperature"] = connection.temperature
    return options


def _unanswered(error: "openai.OpenAIError", connection: Connection) -> BadAnswer:
    """Why there is no answer, in the words of the client or of the server."""
    import openai

    if isinstance(error, openai.APITimeoutError):
        asked = f"asked {connection.retries + 1} times"
        return Unreached(f"the model did not answer within {connection.timeout_s:g} s, {asked}")
    if isinstance(error, openai.RateLimitError):
        return Unreached(f"the model was not reached: too many requests ({printable(error)})")
    if isinstance(error, openai.APIStatusError):
        kind = Rejected if error.status_code in _REJECTED else Unreached
        return kind(
            f"the model was not reached: the server answered {error.status_code} ({printable(error)})"
        )
    if isinstance(error, openai.APIConnectionError):
        cause = error.__cause__ or error
        if isinstance(cause, BadAnswer):
            return cause
        return Unreached(f"the model was not reached: {type(cause).__name__} ({printable(cause)})")
    return Unreached(f"the model was not reached: {printable(error)}")


def _wire(message: Message) -> Any:
    """The message as the protocol wants it, pictures as data URIs."""
    parts: list[dict[str, object]] = [{"type": "text", "text": message.text}]
    for camera, jpeg in message.pictures.items():
        uri = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
        parts += [
            {"type": "text", "text": f"Camera {camera}:"},
            {"type": "image_url", "image_url": {"url": uri}},
        ]
    return {"role": message.role, "content": parts if message.pictures else message.text}
