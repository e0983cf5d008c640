"""Byte channels between the two parties: in memory, over TCP, over TLS; one contract for all of them."""

from spdz.channels.base import Channel
from spdz.channels.frames import AbortReason, DType, FrameKind
from spdz.channels.memory import MemoryChannel, memory_pair
from spdz.channels.socket_channel import SocketChannel

__all__ = ["AbortReason", "Channel", "DType", "FrameKind", "MemoryChannel", "SocketChannel", "memory_pair"]
