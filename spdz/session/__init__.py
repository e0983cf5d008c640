"""Sessions: one tape and one connection, from the handshake to the last result."""

from spdz.session.connect import open_gallery, open_session
from spdz.session.gallery import GallerySession
from spdz.session.session import Result, Session
from spdz.session.strips import Block, Step

__all__ = ["Block", "GallerySession", "Result", "Session", "Step", "open_gallery", "open_session"]
