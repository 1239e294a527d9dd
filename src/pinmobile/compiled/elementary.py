"""Sine, exponential, logarithm and other elementary functions from basic operations.

Each function accepts nodes of a tape and NumPy's float64 numbers and arrays, with the same bits for both, on
every processor. The errors are a few units of the last place; `sincos` is accurate between -1e5 and 1e5.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pinmobile.compiled.tape import (
    Node,
    Number,
    absolute,
    bits,
    float_bits,
    maximum,
    minimum,
    real,
    root,
    select,
)

_ROUNDER = 1.5 * 2.0**52
_TOP = 2**52 - 1  # bits of the fraction of a float
_ONE = float_bits(1.0)


def _mark(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that marks its values on the tape with its name."""

    @functools.wraps(function)
    def run(*given: Number) -> Any:
        result = function(*given)
        if type(result) is not Node:
            return result
        return result.tape.mark(function.__name__, result, *given)

    return run


@_mark
def rounded(x: Number) -> Any:
    """Return the nearest whole number, the even one of two equally near numbers; beyond 2^51, x itself."""
    nearest = (x + _ROUNDER) - _ROUNDER
    return select(absolute(x) < 2.0**51, nearest, x)


@_mark
def floor(x: Number) -> Any:
    """Return the largest whole number <= x."""
    nearest = rounded(x)
    return select(nearest > x, nearest - 1.0, nearest)


def _short(value: float, bits_kept: int) -> float:
    """Return a float with this number of bits after the point; its products with small integers are exact."""
    scale = 2.0**bits_kept
    return math.floor(value * scale) / scale


# pi = math.pi + 1.2246467991473532e-16 as three floats, the first two short.
_PI1 = _short(math.pi, 26)
_PI2 = _short(math.pi - _PI1, 52)
_PI3 = (math.pi - _PI1 - _PI2) + 1.2246467991473532e-16
_PER_PI = 1 / math.pi
_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(11)]
_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(11)]


def _series(c: Sequence[float], z: Number) -> Any:
    """Return c[1] + c[2] z + ... + c[10] z^9, in pairs that the processor computes in parallel."""
    z2 = z * z
    z4 = z2 * z2
    high = ((c[5] + z * c[6]) + z2 * (c[7] + z * c[8])) + z4 * (c[9] + z * c[10])
    return ((c[1] + z * c[2]) + z2 * (c[3] + z * c[4])) + z4 * high


def sincos(x: Number) -> tuple[Any, Any]:
    """Return sine and cosine: reduction to [-pi/2, pi/2], then Taylor series with errors below 2e-17."""
    shifted = x * _PER_PI + _ROUNDER
    k = shifted - _ROUNDER
    r = ((x - k * _PI1) - k * _PI2) - k * _PI3
    # If the last bit of k is 1, both change their sign: it becomes the sign bit.
    flip = bits(shifted) << 63
    z = r * r
    s, c = r + (r * z) * _series(_SINE, z), 1.0 + z * _series(_COSINE, z)
    s, c = real(bits(s) ^ flip), real(bits(c) ^ flip)
    if type(s) is Node:
        return s.tape.mark("sin", s, x), s.tape.mark("cos", c, x)
    return s, c


def sin(x: Number) -> Any:
    """Return the sine."""
    return sincos(x)[0]


def cos(x: Number) -> Any:
    """Return the cosine."""
    return sincos(x)[1]


def tan(x: Number) -> Any:
    """Return the tangent."""
    s, c = sincos(x)
    return s / c


def polynomial(c: Sequence[float], z: Number) -> Any:
    """Return c[0] + c[1] z + ... by Estrin's scheme, four terms at a time."""
    z2 = z * z
    z4 = z2 * z2

    def pair(i: int) -> Any:
        return c[i] + z * c[i + 1] if i + 1 < len(c) else c[i]

    def four(i: int) -> Any:
        return pair(i) + z2 * pair(i + 2) if i + 2 < len(c) else pair(i)

    last = (len(c) - 1) // 4 * 4
    result = four(last)
    for i in range(last - 4, -1, -4):
        result = four(i) + z4 * result
    return result


_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_TAYLOR = [1 / math.factorial(k) for k in range(16)]


@_mark
def exp(x: Number) -> Any:
    """Return the exponential; infinity above 709.78, and 0 below -708, where results would be subnormal."""
    result = _exp_bounded(minimum(709.78, maximum(-708.0, x)))
    result = select(x > 709.78, math.inf, select(x < -708.0, 0.0, result))
    return select(x == x, result, x)


def _exp_bounded(x: Number) -> Any:
    """Return the exponential of a number in [-708, 709.78]."""
    shifted = x * (1 / math.log(2)) + _ROUNDER
    k = shifted - _ROUNDER
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    # 2^1024 exceeds float64: half of the power, then a product with 2.
    power_of_two = real((bits(shifted) + 1022) << 52)
    return (polynomial(_TAYLOR[:14], r) * power_of_two) * 2.0


@_mark
def expm1(x: Number) -> Any:
    """Return exp(x) - 1, accurate near zero too."""
    return select(absolute(x) < 0.35, x * polynomial(_TAYLOR[1:], x), exp(x) - 1.0)


def sinh(x: Number) -> Any:
    """Return the hyperbolic sine."""
    excess = expm1(absolute(x))
    size = 0.5 * (excess + excess / (excess + 1.0))
    size = select(absolute(x) > 40.0, 0.5 * exp(absolute(x)), size)
    return select(x < 0.0, -size, size)


def cosh(x: Number) -> Any:
    """Return the hyperbolic cosine."""
    power = exp(absolute(x))
    return 0.5 * (power + 1.0 / power)


# Cephes (S. Moshier, 1989): rational approximations of tanh and arctan.
_TANH_P = (-1.61468768441708447952e3, -9.92877231001918586564e1, -9.64399179425052238628e-1)
_TANH_Q = (4.84406305325125486048e3, 2.23548839060100448583e3, 1.12811678491632931402e2, 1.0)


@_mark
def tanh(x: Number) -> Any:
    """Return the hyperbolic tangent."""
    size, z = absolute(x), x * x
    small = x + (x * z) * (_horner(_TANH_P, z) / _horner(_TANH_Q, z))
    large = 1.0 - 2.0 / (_exp_bounded(minimum(40.0, 2.0 * size)) + 1.0)
    large = select(x < 0.0, -large, large)
    return select(size < 0.625, small, large)


def _horner(c: Sequence[float], z: Number) -> Any:
    result = c[-1]
    for coefficient in reversed(c[:-1]):
        result = result * z + coefficient
    return result


# Coefficients from e_log.c of fdlibm (Sun Microsystems, 1993).
_LOG = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860510658591e-01,
)


@_mark
def log(x: Number) -> Any:
    """Return the natural logarithm; minus infinity at 0, and NaN below."""
    tiny = x < 2.0**-1022  # subnormal: the bits do not contain the exponent
    result = _log_of_normal(
        select(tiny, x * 2.0**54, x), select(tiny, 2.0**52 + 1023.0 + 54.0, 2.0**52 + 1023.0)
    )
    result = select(x == 0.0, -math.inf, select(x > 0.0, result, math.nan))
    return select(x == math.inf, math.inf, result)


def _log_of_normal(x: Number, shift: Number = 2.0**52 + 1023.0) -> Any:
    """Return the natural logarithm of a normal number > 0, whose exponent is counted from `shift`."""
    word = bits(x)
    fraction = real((word & _TOP) | _ONE)
    exponent = real((word >> 52) | float_bits(2.0**52)) - shift
    high = fraction > math.sqrt(2)
    fraction, exponent = (select(high, fraction * 0.5, fraction), select(high, exponent + 1.0, exponent))
    f = fraction - 1.0
    s = f / (2.0 + f)
    z = s * s
    rest = z * polynomial(_LOG, z)
    half = (0.5 * f) * f
    return exponent * _LN2_HIGH - ((half - (s * (half + rest) + exponent * _LN2_LOW)) - f)


@_mark
def log1p(x: Number) -> Any:
    """Return log(1 + x), accurate near zero too."""
    sum_ = 1.0 + x
    return select(sum_ == 1.0, x, log(sum_) * (x / select(sum_ == 1.0, 1.0, sum_ - 1.0)))


_ARCTAN_P = (
    -6.485021904942025371773e1,
    -1.228866684490136173410e2,
    -7.500855792314704667340e1,
    -1.615753718733365076637e1,
    -8.750608600031904122785e-1,
)
_ARCTAN_Q = (
    1.945506571482613964425e2,
    4.853903996359136964868e2,
    4.328810604912902668951e2,
    1.650270098316988542046e2,
    2.485846490142306297962e1,
    1.0,
)


def _angle(y: Number, x: Number) -> Any:
    """Return the angle of (x, y) in the first quadrant; 0 for (0, 0)."""
    steep, middle = y > 2.41421356237309504880 * x, y > 0.66 * x
    top = select(steep, -x, select(middle, y - x, y))
    bottom = select(steep, y, select(middle, y + x, x))
    is_zero = bottom == 0.0
    t = select(is_zero, 0.0, top) / select(is_zero, 1.0, bottom)
    z = t * t
    series = t + (t * z) * (polynomial(_ARCTAN_P, z) / polynomial(_ARCTAN_Q, z))
    rest = select(steep, 6.123233995736765886130e-17, select(middle, 3.061616997868382943065e-17, 0.0))
    return select(steep, math.pi / 2, select(middle, math.pi / 4, 0.0)) + (series + rest)


@_mark
def arctan2(y: Number, x: Number) -> Any:
    """Return the angle of (x, y) in [-pi, pi]; both arguments are finite."""
    angle = _angle(absolute(y), absolute(x))
    angle = select(x < 0.0, math.pi - angle, angle)
    return select(y < 0.0, -angle, angle)


@_mark
def arctan(x: Number) -> Any:
    """Return the angle whose tangent is x."""
    size = absolute(x)
    inverse = size > 1.0
    angle = _angle(select(inverse, 1.0, size), select(inverse, select(inverse, 1.0, size) / size, 1.0))
    return select(x < 0.0, -angle, angle)


def arcsin(x: Number) -> Any:
    """Return the angle whose sine is x."""
    return arctan2(x, root((1.0 - x) * (1.0 + x)))


def arccos(x: Number) -> Any:
    """Return the angle whose cosine is x."""
    return arctan2(root((1.0 - x) * (1.0 + x)), x)


def power(base: Number, exponent: Number) -> Any:
    """Return a power: by products and a root for a simple constant exponent, else by exp."""
    value = exponent.value if type(exponent) is Node else exponent
    if value is None:
        return _any_power(base, exponent)
    value = float(value)
    if value != np.rint(value):
        if value * 2 == np.rint(value * 2) and abs(value) < 8:
            return power(base, math.floor(value)) * root(base)
        return exp(value * log(base))
    if abs(value) > 64:
        return exp(value * log(absolute(base))) * (1.0 if value % 2 == 0 else select(base < 0.0, -1.0, 1.0))
    product, square, count = None, base, int(abs(value))
    while count:
        if count & 1:
            product = square if product is None else product * square
        square, count = square * square, count >> 1
    if product is None:
        return 1.0
    return product if value > 0 else 1.0 / product


def _any_power(base: Number, exponent: Number) -> Any:
    size = exp(exponent * log(absolute(base)))
    is_whole = rounded(exponent) == exponent
    is_odd = rounded(0.5 * exponent) * 2.0 != exponent
    negative = select(is_whole, select(is_odd, -size, size), math.nan)
    return select(exponent == 0.0, 1.0, select(base < 0.0, negative, size))


def on_floats(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function for NumPy arrays, without warnings, like compiled code."""

    def run(*given: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*(np.asarray(x, np.float64) for x in given))[()]

    return run


ELEMENTARY = (sin, cos, tan, exp, expm1, log, log1p, sinh, cosh, tanh, arcsin, arccos, arctan, arctan2)
"""Functions that have the same name in NumPy."""
