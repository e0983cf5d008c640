"""Distributed comparison function: keys k_0, k_1 with Eval(0, x) + Eval(1, x) = beta [x < a] in F_p.

Neither key tells anything about the threshold a or the payload beta. n keys are dealt at once and evaluated
at one or k public points each, which is local: more points tell no more. n is public and says which tree it
is (:func:`spdz.dcf.format.digit_width`): with few keys calls are what costs, with many it is bytes.

A tree has one level for each digit. A party's state at a node is a seed with control bits; on the path
of a the parties' seeds are independent and their control bits differ (at the root they are the party's
index), off the path both states are equal. H is the fixed-key hash of :mod:`spdz.arithmetic.prf`; where a
control bit is set, a dealt correction word (CW) is XORed to what is hashed. At each node y = H(..) ^ (t CW)
yields the payload Conv(y) = y mod p, and party 1 negates: off the path the two cancel, on the path the dealer
chose the CW so that they leave a given g. At a node, T is the party with t = 1 and O the other.

**Binary tree.** 127-bit seeds; t is the block's top bit. The child in direction d is H(s ^ (2^63 d + 1)), and
where t = 1 the level's CW is XORed: one seed for both directions and a control bit for each. Node i yields
payload j = Conv(H(s ^ 2j) ^ (t CW_ij)), which leaves g_i = beta (a_(i+1) - a_i), where a_1 is the most
significant bit and a_0 = a_(bits+1) = 0. The sum over the path of x telescopes to beta a_(l+1) when x leaves
the path of a after node l, which is beta [x < a], and to 0 for x = a.

**Radix R = 4 or 16.** L digits, the first filled up with zero bits; digits that cannot occur are dealt like
the others. Each word has 63 bits of seed and its own control bit on top, the high word's being t. The child
in direction d is H(s ^ d), each half XORed with that half of CW_id where its control bit is set. With x_b the
hash of party b, CW_id = x_0 ^ x_1 for d != a_i, which makes the states equal; for d = a_i it is x_0 ^ x_1 ^
coin, where coin is random but for its two top bits, which are 1. Node i yields in direction d the payload j =
Conv(H(s ^ d ^ 2^8 (j + 1)) ^ (t CW_ijd)), which leaves g_id = beta [d < a_i]: 0 as long as x stays on the
path, then beta [x < a] once. So there is no payload at the leaf.

**Cost.** AES calls at k points: n k (bits + w (bits + 1)) binary, n k (L - 1 + w L) else; for the dealer 2n
(2 bits + w (bits + 1)) and 2n R (L - 1 + w L).

**Security.** Against the holder of one key, hybrids down the path: at node i the *other* party's seed is
uniform given all that precedes, so H gives fresh masks at its distinct inputs, 2 + w or R (1 + w) of them:
two digits share none. The lost child masks its seed CW (it is the XOR of both parties' lost children).
*Binary:* the children's top bits mask both control bits, the kept child is the next uniform seed. *Else:* in
each half of the kept child, with O the party without the control bit, O has x_O and T has x_T ^ CW = x_O ^
coin. To O, x_T masks the CW and coin the seed of T; to T, x_O masks the CW and coin keeps x_O, the seed of O,
uniform. *Payload:* CW = y_T ^ r with r = Conv(y_O) +- g (mod p). It is masked by y_T for O, and by y_O for T
as r is then uniform; its top bit too, which weighs 1 (mod p): a party that found it to be always 0 would know
the path. So the CWs are indistinguishable from uniform strings, whichever of them the public digits of x
select; reduction mod p adds at most 2^-126 each. Control bits may stay in the hash input: the holder knows
the other's anyway, and the rest is uniform. They are applied as masks; what is read depends on public digits
only.

In the ideal-cipher model an attacker who makes q AES calls under one fixed key, under which m seeds are in
use, succeeds with probability about ((2 + w) q m + m^2) / 2^127: tweaks do not separate the m targets. Each
batch has its own public random key out of 2^32, so m is the (bits + 1) n of a batch and not of a mission:
2^20 for 8192 keys of 78 bits, which leaves 2^-41 for q = 2^64. With radix R it is (R (1 + w) q m + m^2) /
2^126 and R m at most 2^14. The root seeds must be pseudo-random, each used for one key only.

**Key format**, the same bytes for both parties, 64-bit words, little-endian:

    16 bytes                hash index below 2^32
    binary:
    (bits, n, 2) words      seed CW; top bit: control-bit correction of the left child
    (bits + 1, w, n, 2)     payload CWs; top bit, the same for all j: left ^ right control-bit correction
                            (0 at the leaf)
    radix R:
    (L - 1, n, R, 2)        child CWs
    (w, L, n, R, 2)         payload CWs

Sources: Boyle, Gilboa, Ishai, "Secure computation with preprocessing via function secret sharing", TCC 2019;
Boyle et al., "Function secret sharing for mixed-mode and fixed-point secure computation", EUROCRYPT 2021
(the DCF); Boneh et al., "Lightweight techniques for private heavy hitters", IEEE S&P 2021 (a payload at every
prefix). Departures: payload CWs are XORed before conversion; in the binary tree both directions share them.
With radix R the two control bits let whole blocks be masked at once.
"""

from spdz.dcf.dealing import generate
from spdz.dcf.evaluation import evaluate
from spdz.dcf.format import key_bytes
from spdz.dcf.keys import Keys

__all__ = ["Keys", "evaluate", "generate", "key_bytes"]
