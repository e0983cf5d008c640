"""Galleries: two robots' descriptors in numbered slots, any pair of which can be compared."""

from spdz.gallery.format import GalleryHeader, gallery_bytes
from spdz.gallery.tape import GalleryTape, SlotRecord, TileRecord
from spdz.gallery.writer import GalleryWriter

__all__ = [
    "GalleryHeader",
    "GalleryTape",
    "GalleryWriter",
    "SlotRecord",
    "TileRecord",
    "gallery_bytes",
]
