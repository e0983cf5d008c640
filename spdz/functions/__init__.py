"""Functions composed of gates: roots, reciprocals, division, normalisation."""

from spdz.functions.division import divide, reciprocal
from spdz.functions.normalisation import l1_normalised, l2_normalised
from spdz.functions.power import power
from spdz.functions.roots import reciprocal_sqrt, sqrt

__all__ = ["divide", "l1_normalised", "l2_normalised", "power", "reciprocal", "reciprocal_sqrt", "sqrt"]
