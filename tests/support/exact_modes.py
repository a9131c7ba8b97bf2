"""Frequencies of a hanging beam to 50 digits: the element of `sim.beam.ancf`, assembled and solved with mpmath alone.

Axial equilibrium by Newton's method, then transverse modes by inverse iteration about a guess, with the band matrix
factored in 50 digits.
"""

import mpmath as mp

DIGITS = 50
_HALF_BAND = 3


def _shapes(x, h, derivative):
    if derivative == 0:
        return [1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)]
    if derivative == 1:
        return [(6 * x**2 - 6 * x) / h, 1 - 4 * x + 3 * x**2, (6 * x - 6 * x**2) / h, 3 * x**2 - 2 * x]
    return [(12 * x - 6) / h**2, (6 * x - 4) / h, (6 - 12 * x) / h**2, (6 * x - 2) / h]


def _gauss_3_and_4():
    """Positions and weights on 0 to 1: the default of the axial strain, and one that is exact for mass and bending."""
    outer = mp.sqrt(mp.mpf(3) / 5)
    three = [(-outer, mp.mpf(5) / 9), (mp.mpf(0), mp.mpf(8) / 9), (outer, mp.mpf(5) / 9)]
    four = []
    for sign in (-1, 1):
        at = mp.sqrt((3 + sign * 2 * mp.sqrt(mp.mpf(6) / 5)) / 7)
        weight = (18 - sign * mp.sqrt(30)) / 36
        four += [(at, weight), (-at, weight)]
    return [[((1 + x) / 2, w / 2) for x, w in points] for points in (three, four)]


def _solver(matrix):
    """Solution with a symmetric matrix of lower rows, ``matrix[i][k] = A[i, i - k]``, by L D L^T."""
    n = len(matrix)
    lower, pivot = [[mp.mpf(0)] * (_HALF_BAND + 1) for _ in range(n)], [mp.mpf(0)] * n
    for i in range(n):
        for j in range(max(0, i - _HALF_BAND), i + 1):
            rest = matrix[i][i - j] - mp.fsum(
                lower[i][i - k] * lower[j][j - k] * pivot[k] for k in range(max(0, i - _HALF_BAND), j)
            )
            if i == j:
                pivot[i] = rest
            else:
                lower[i][i - j] = rest / pivot[j]

    def solve(right):
        x = list(right)
        for i in range(n):
            x[i] -= mp.fsum(lower[i][i - k] * x[k] for k in range(max(0, i - _HALF_BAND), i))
        x = [value / d for value, d in zip(x, pivot, strict=True)]
        for i in reversed(range(n)):
            x[i] -= mp.fsum(lower[k][k - i] * x[k] for k in range(i + 1, min(n, i + _HALF_BAND + 1)))
        return x

    return solve


def _product(matrix, x):
    out = [mp.mpf(0)] * len(x)
    for i, row in enumerate(matrix):
        for k in range(min(i, _HALF_BAND) + 1):
            out[i] += row[k] * x[i - k]
            if k:
                out[i - k] += row[k] * x[i]
    return out


def _dot(a, b):
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


class _HangingBeam:
    """Element properties and matrices of one direction, in 50 digits."""

    def __init__(self, properties):
        p = properties
        if p.orientation != "hanging" or p.clamp is not None:
            msg = "the reference is for a hanging beam in a rigid clamp"
            raise ValueError(msg)
        self.count, self.h = p.elements, mp.mpf(p.length_m) / p.elements
        width, thickness = ([mp.mpf(float(x)) for x in values] for values in (p.width_m, p.thickness_m))
        modulus, self.gravity = mp.mpf(p.elastic_modulus_pa), mp.mpf(p.gravity_m_s2)
        self.axial = [modulus * w * t for w, t in zip(width, thickness, strict=True)]
        self.bend = [modulus * w * t**3 / 12 for w, t in zip(width, thickness, strict=True)]
        self.line = [mp.mpf(p.density_kg_m3) * w * t for w, t in zip(width, thickness, strict=True)]
        self.points = []
        for point in p.point_masses:
            at = mp.mpf(point.position_m) / self.h
            element = min(int(at), self.count - 1)
            self.points.append(
                (element, at - element, mp.mpf(point.mass_kg), mp.mpf(point.rotary_inertia_kg_m2))
            )
        self.few, self.many = _gauss_3_and_4()

    def _add(self, matrix, element, value, factor):
        for k in range(4):
            for m in range(k + 1):
                matrix[2 * element + k][k - m] += factor * value[k] * value[m]

    def _empty(self):
        return [[mp.mpf(0)] * (_HALF_BAND + 1) for _ in range(2 * (self.count + 1))]

    def _slopes(self, q):
        """Element, slopes of the shapes, displacement gradient and weight at each Gauss point of the axial strain."""
        for e in range(self.count):
            for x, weight in self.few:
                slopes = _shapes(x, self.h, 1)
                yield e, slopes, _dot(slopes, q[2 * e : 2 * e + 4]), self.h * weight * self.axial[e]

    def bending(self):
        out = self._empty()
        for e in range(self.count):
            for x, weight in self.many:
                self._add(out, e, _shapes(x, self.h, 2), self.h * weight * self.bend[e])
        return out

    def mass(self):
        out = self._empty()
        for e in range(self.count):
            for x, weight in self.many:
                self._add(out, e, _shapes(x, self.h, 0), self.h * weight * self.line[e])
        for e, x, mass, inertia in self.points:
            self._add(out, e, _shapes(x, self.h, 0), mass)
            self._add(out, e, _shapes(x, self.h, 1), inertia)
        return out

    def equilibrium(self):
        """Axial displacements and slopes under the weight, those of the clamp first."""
        q = [mp.mpf(0)] * (2 * (self.count + 1))
        bending, rigid = self.bending(), [mp.mpf(1 - i % 2) for i in range(len(q))]
        weight = [self.gravity * x for x in _product(self.mass(), rigid)]
        for _ in range(20):
            tangent = [list(row) for row in bending]
            residual = [w - b for w, b in zip(weight, _product(bending, q), strict=True)]
            for e, slopes, gradient, stiffness in self._slopes(q):
                strain = gradient + gradient**2 / 2
                for k in range(4):
                    residual[2 * e + k] -= stiffness * strain * (1 + gradient) * slopes[k]
                self._add(tangent, e, slopes, stiffness * ((1 + gradient) ** 2 + strain))
            step = _solver(tangent[2:])(residual[2:])
            q[2:] = [a + b for a, b in zip(q[2:], step, strict=True)]
            if max(abs(x) for x in step) < mp.mpf(10) ** (4 - DIGITS):
                return q
        msg = "Newton's method did not converge"
        raise ArithmeticError(msg)

    def transverse(self):
        """Stiffness and mass of the motion across the axis, without the clamp's two coordinates."""
        stiffness = self.bending()
        for e, slopes, gradient, factor in self._slopes(self.equilibrium()):
            self._add(stiffness, e, slopes, factor * (gradient + gradient**2 / 2))
        return stiffness[2:], self.mass()[2:]


def exact_frequencies_hz(properties, guess_hz):
    """Natural frequency nearest to each guess, as mpmath numbers."""
    with mp.workdps(DIGITS):
        stiffness, mass = _HangingBeam(properties).transverse()
        return [_nearest_hz(stiffness, mass, mp.mpf(float(guess))) for guess in guess_hz]


def _nearest_hz(stiffness, mass, guess_hz):
    # beside the guess, so that the matrix is not singular
    shift = (2 * mp.pi * guess_hz) ** 2 * (1 + mp.mpf(10) ** -6)
    solve = _solver(
        [[k - shift * m for k, m in zip(*rows, strict=True)] for rows in zip(stiffness, mass, strict=True)]
    )
    vector, last = [mp.mpf(1 + i % 7) for i in range(len(stiffness))], mp.mpf(0)
    for _ in range(30):
        vector = solve(_product(mass, vector))
        size = mp.sqrt(_dot(vector, _product(mass, vector)))
        vector = [x / size for x in vector]
        square = _dot(vector, _product(stiffness, vector))
        if abs(square / last - 1 if last else 1) < mp.mpf(10) ** -30:
            return mp.sqrt(square) / (2 * mp.pi)
        last = square
    msg = f"inverse iteration about {mp.nstr(guess_hz, 8)} Hz did not converge"
    raise ArithmeticError(msg)
