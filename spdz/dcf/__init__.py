"""Distributed comparison function: keys k_0, k_1 with Eval(0, x) + Eval(1, x) = beta [x < a] in F_p.

Neither key tells anything about the threshold a or the payload beta. n keys are dealt and evaluated at once.

**Construction.** A binary tree of depth ``bits``; a party's state at a node is a 127-bit seed with a control
bit t as the block's top bit (at the root t is the party's index). With H the fixed-key hash of
:mod:`spdz.prf`, the child in direction d is H(s ^ (2^63 d + 1)), and where t = 1 the level's correction word
(CW) is XORed to it: one seed for both directions and a control bit for each. On the path of a the two
parties' seeds are independent and t_0 ^ t_1 = 1; off the path both states are equal. Node i also yields
payload j = Conv(H(s ^ 2j) ^ (t CW_ij)), Conv(y) = y mod p, and party 1 negates: off the path the two cancel,
on the path the dealer chose CW_ij so that they leave g_i = beta (a_(i+1) - a_i), where a_1 is the most
significant bit and a_0 = a_(bits+1) = 0. The sum over the path of x telescopes to beta a_(l+1) when x leaves
the path of a after node l, which is beta [x < a], and to 0 for x = a.

**Cost.** AES calls: n (bits + w (bits + 1)) for a party, 2n (2 bits + w (bits + 1)) for the dealer.

**Security.** Against the holder of one key, hybrids down the path: at node i the *other* party's seed is
uniform given all that precedes, so H gives fresh masks at its 2 + w distinct inputs. The lost child masks the
seed CW (it is the XOR of both parties' lost children), the children's top bits mask both control bits, the
kept child is the next uniform seed. Let T be the party with t = 1 and O the one without: CW_ij = y_T ^ r with
r = Conv(y_O) +- g_i (mod p). It is masked by y_T for O, and by y_O for T as r is then uniform. So the CWs are
indistinguishable from uniform strings; reduction mod p adds at most w (bits + 1) 2^-126. The control bit may
stay in the hash input: the holder knows the other's anyway, and the remaining 127 bits are uniform.

In the ideal-cipher model an attacker who makes q AES calls under one fixed key, under which m seeds are in
use, succeeds with probability about ((2 + w) q m + m^2) / 2^127: tweaks do not separate the m targets. Each
batch has its own public random key out of 2^32, so m is the (bits + 1) n of a batch and not of a mission:
2^20 for 8192 keys of 78 bits, which leaves 2^-41 for q = 2^64. The root seeds must be pseudo-random, each
used for one key only.

**Key format**, the same bytes for both parties, 64-bit words, little-endian, node-major:

    16 bytes                hash index below 2^32
    (bits, n, 2) words      seed CW; top bit: control-bit correction of the left child
    (bits + 1, w, n, 2)     payload CWs; top bit, the same for all j: left ^ right control-bit correction
                            (0 at the leaf)

Sources: Boyle, Gilboa, Ishai, "Secure computation with preprocessing via function secret sharing", TCC 2019;
Boyle et al., "Function secret sharing for mixed-mode and fixed-point secure computation", EUROCRYPT 2021
(the DCF); Boneh et al., "Lightweight techniques for private heavy hitters", IEEE S&P 2021 (a payload at every
prefix). Departure: payload CWs are XORed before conversion, and are shared by both directions.
"""

from spdz.dcf.dealing import generate
from spdz.dcf.evaluation import evaluate
from spdz.dcf.format import key_bytes

__all__ = ["evaluate", "generate", "key_bytes"]
