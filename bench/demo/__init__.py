"""Two robots in MIT's corridors: real laser scans, place descriptors and ground truth for ``spdz demo``."""
