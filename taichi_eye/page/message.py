"""Messages to the browser: a head of names and numbers, and what is too large for it."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any


def packed(head: Mapping[str, Any], data: bytes | memoryview = b"") -> bytes:
    """The length of the head (4 bytes, little endian), the head as JSON, the data."""
    text = json.dumps(head, allow_nan=False).encode()
    return b"".join((struct.pack("<I", len(text)), text, data))


def sized(message: bytes) -> bytes:
    """A message of a stream: its length (4 bytes, little endian) before it."""
    return struct.pack("<I", len(message)) + message
