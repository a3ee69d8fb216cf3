"""The connection to a model's server: what comes back is bounded while it arrives, and nobody else is asked.

A body is counted as it is received and again as it is unpacked, so that neither one without an end nor a
small one that unpacks into gigabytes is ever held in memory. Redirects are not followed: the scene and the
key go to the address that the person gave, and to no other.
"""

import zlib
from collections.abc import AsyncIterator

import httpx2
import openai

from rf_exp.datagen.brain.reading import BadAnswer, Unreached
from rf_exp.texts import printable

LARGEST_BODY = 2**20  # bytes, received and unpacked; an answer of 4000 tokens has some 20 000


def connection() -> httpx2.AsyncClient:
    """A client of HTTP with the limits of the `openai` client, proxies of the environment included."""
    return openai.DefaultAsyncHttpxClient(
        follow_redirects=False,
        headers={"Accept-Encoding": "gzip"},
        event_hooks={"response": [_bound]},
    )


async def _bound(response: httpx2.Response) -> None:
    """Puts the limit between the connection and everything that reads the body, also that of an error."""
    if response.has_redirect_location:
        raise Unreached(
            f"the model was not reached: the server answered {response.status_code} and sends on to "
            f"{printable(response.headers['Location'])!r}; no redirect is followed, so that the key goes to "
            "no other place; if that is the right one, give it as brain.base_url"
        )
    packed = response.headers.pop("Content-Encoding", "identity").strip().lower()
    if packed not in ("gzip", "identity"):
        raise BadAnswer(f"the answer is packed as {printable(packed, 60)!r}; asked for was gzip or nothing")
    assert isinstance(response.stream, httpx2.AsyncByteStream)
    response.stream = _Bounded(response.stream, packed == "gzip")
    response.encoding = "utf-8"  # whatever the server says: some of Python's codecs unpack, too


class _Bounded(httpx2.AsyncByteStream):
    """The unpacked bytes of a body. Raises BadAnswer once there are more than LARGEST_BODY."""

    def __init__(self, stream: httpx2.AsyncByteStream, gzip: bool) -> None:
        self._stream, self._gzip = stream, gzip

    async def __aiter__(self) -> AsyncIterator[bytes]:
        inflate = zlib.decompressobj(16 + zlib.MAX_WBITS) if self._gzip else None
        received = unpacked = 0
        async for chunk in self._stream:
            received += len(chunk)
            if inflate is not None:
                try:
                    chunk = inflate.decompress(chunk, LARGEST_BODY - unpacked + 1)
                except zlib.error as error:
                    raise BadAnswer(f"the answer cannot be unpacked: {error}") from None
            unpacked += len(chunk)
            if max(received, unpacked) > LARGEST_BODY:
                raise BadAnswer(f"the answer is longer than {LARGEST_BODY} bytes; the rest was not read")
            yield chunk
        if inflate is not None and received and not inflate.eof:
            raise BadAnswer("the answer cannot be unpacked: it is cut off")

    async def aclose(self) -> None:
        await self._stream.aclose()
