"""Value and gradient of a template at the pixels of a frame, in passes over all pixels of a marker.

Each pass is one loop over many pixels without a branch, which the compiler vectorises; it would not vectorise a single
loop that does everything. Between grid points the template is the uniform cubic B-spline of its coefficients (de Boor
1978, A Practical Guide to Splines, ch. IX): precomputed polynomials for each cell would need sixteen times the memory
and be limited by access to it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic, register_jitable
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage

# Rows of the table of pixels: fraction between two grid points along the row (t) and down the column (s), position in
# the grid relative to the marker's centre, the template's value and its gradient along the grid, the pixel, whether it
# belongs to the marker, and whether it lies in the image.
ROWS = 10
T, S, FROM_U, FROM_V, VALUE, SLOPE_U, SLOPE_V, PIXEL, WANTED, SEEN = range(ROWS)
# Sums over pixels: chi-square, the products in pairs of gradient (p along grid rows, q along columns), value (v), one
# (o) and rotation (t), the product of each with the residual (r), then pixels used, saturated and expected.
SUMS = 24
USED, CLIPPED, EXPECTED = 21, 22, 23
# Pixels per band: their table fits the processor's caches.
BAND_PIXELS = 2048
# Sums may be reordered and products fused, so that loops vectorise. Such a function must be inlined into its caller:
# otherwise the first run calls the copy that was compiled alone, later runs the copy optimised once more inside
# the cached caller, and the two round differently.
REORDER = {"contract", "reassoc", "nsz"}

# Weights of the four relevant coefficients at a fraction between two knots: coefficients of its powers 0 to 3, followed
# by those of the derivatives of the weights; all times 6.
_BASIS = np.array(
    [
        [1.0, 4.0, 1.0, 0.0, -3.0, 0.0, 3.0, 0.0],
        [-3.0, 0.0, 3.0, 0.0, 6.0, -12.0, 6.0, 0.0],
        [3.0, -6.0, 3.0, 0.0, -3.0, 9.0, -9.0, 3.0],
        [-1.0, 3.0, -3.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    ]
)


def _lanes(values: Any) -> ir.Constant:
    return ir.Constant(
        ir.VectorType(ir.FloatType(), len(values)), [ir.Constant(ir.FloatType(), v) for v in values]
    )


def _picked(builder: Any, vector: Any, lanes: list[int]) -> Any:
    index = ir.IntType(32)
    mask = ir.Constant(ir.VectorType(index, len(lanes)), [ir.Constant(index, k) for k in lanes])
    return builder.shuffle_vector(vector, vector, mask)


@intrinsic
def _down_the_columns(
    _typing_context: Any, coefs: Any, _columns: Any, _first: Any, _place: Any, out: Any, _to: Any
) -> Any:
    """Weighted sums over four rows of four coefficients, for the value at `place` and for the derivative.

    Called as ``(coefs, columns, first, place, out, to)`` with flat float32 arrays: the upper left coefficient is
    ``coefs[first]``, rows are `columns` apart; the four values and derivatives are written to ``out[to : to + 8]``,
    all eight in one vector, which the compiler does not achieve by itself.
    """
    signature = types.void(coefs, types.intp, types.intp, types.float32, out, types.intp)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        grid = context.make_array(sig.args[0])(context, builder, args[0])
        _, columns, first, place, _, to = args
        sums = context.make_array(sig.args[4])(context, builder, args[4])
        eight, four = ir.VectorType(ir.FloatType(), 8), ir.VectorType(ir.FloatType(), 4)

        def add_product(a: Any, b: Any, c: Any) -> Any:
            # "contract": one instruction where the processor has it.
            product = builder.fmul(a, b, flags=("contract",))
            return builder.fadd(product, c, flags=("contract",))

        alone = builder.insert_element(_lanes([0.0] * 8), place, ir.Constant(ir.IntType(32), 0))
        places = _picked(builder, alone, [0] * 8)
        weights: Any = _lanes(_BASIS[3] / 6.0)
        for power in (2, 1, 0):
            weights = add_product(weights, places, _lanes(_BASIS[power] / 6.0))
        total: Any = _lanes([0.0] * 8)
        for r in range(4):
            index = builder.add(first, builder.mul(columns, ir.Constant(columns.type, r)))
            row = builder.load(builder.bitcast(builder.gep(grid.data, [index]), four.as_pointer()), align=4)
            twice = _picked(builder, row, [0, 1, 2, 3, 0, 1, 2, 3])
            total = add_product(_picked(builder, weights, [r] * 4 + [4 + r] * 4), twice, total)
        builder.store(total, builder.bitcast(builder.gep(sums.data, [to]), eight.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature, code


# Compiled callers omit the typing context.
_weigh: Any = _down_the_columns

# The pixels of a frame as kernels take them, one of both arrays empty: all but `_fill_pixels` is compiled once, not for
# each type of pixels, which would take 15 s.
Picture = tuple[NDArray[np.uint8], NDArray[np.uint16]]
_NO_8, _NO_16 = np.empty((0, 0), dtype=np.uint8), np.empty((0, 0), dtype=np.uint16)


def picture(image: GrayImage) -> Picture:
    """Pixels of a frame, shape (height, width), for compiled code; a copy only where they are not contiguous."""
    pixels = np.ascontiguousarray(image)
    if pixels.dtype == np.uint8:
        return np.asarray(pixels, dtype=np.uint8), _NO_16
    return _NO_8, np.asarray(pixels, dtype=np.uint16)


PixelBuffers = tuple[
    NDArray[np.float32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.uint8]
]


@njit(cache=True, nogil=True)
def make_pixel_buffers(pixels: int | np.int64) -> PixelBuffers:
    """Buffers for a number of pixels: their table, cells, nearest grid points, column sums and marks."""
    return (
        np.empty((ROWS, pixels), dtype=np.float32),
        np.empty(pixels, dtype=np.int32),
        np.empty(pixels, dtype=np.int32),
        np.empty(8 * pixels, dtype=np.float32),
        np.empty(pixels, dtype=np.uint8),
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True, fastmath=REORDER)
def fill_positions(
    centre: FloatArray,
    matrix: FloatArray,
    box: NDArray[np.int64],
    shape: tuple[int, int],
    table: NDArray[np.float32],
    cell: NDArray[np.int32],
    nearest: NDArray[np.int32],
) -> None:
    """Positions of pixels in a template's grid: T, S, FROM_U, FROM_V and, where inside the grid, WANTED.

    Parameters
    ----------
    centre : array, shape (2,)
        Marker's centre in the image, px.
    matrix : array, shape (2, 2)
        From the image to the grid.
    box : int array, shape (5,)
        First column, columns, first row, rows and stride of the pixels.
    shape : rows and columns of the grid
    cell, nearest : int arrays
        Filled with the flat index of the upper left of the 16 coefficients, and of the nearest grid point; of some
        point inside for pixels outside the grid.
    """
    rows, cols = shape
    left, across, top, down, stride = box[0], box[1], box[2], box[3], box[4]
    a00, a01, a10, a11 = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    u0, v0 = 0.5 * (cols - 1), 0.5 * (rows - 1)
    last_u, last_v = cols - 3.0, rows - 3.0
    wide = np.int32(cols)
    n = 0
    for j in range(down):
        px, py = left - centre[0], top + j * stride - centre[1]
        row_u, row_v = a00 * px + a01 * py, a10 * px + a11 * py
        step_u, step_v = a00 * stride, a10 * stride
        for i in range(across):
            from_u, from_v = step_u * i + row_u, step_v * i + row_v
            gu, gv = from_u + u0, from_v + v0
            inside_u, inside_v = min(max(gu, 1.0), last_u), min(max(gv, 1.0), last_v)
            iu, iv = np.int32(inside_u), np.int32(inside_v)
            cell[n + i] = (iv - np.int32(1)) * wide + iu - np.int32(1)
            nearest[n + i] = np.int32(inside_v + 0.5) * wide + np.int32(inside_u + 0.5)
            table[T, n + i] = inside_u - iu
            table[S, n + i] = inside_v - iv
            table[FROM_U, n + i] = from_u
            table[FROM_V, n + i] = from_v
            table[WANTED, n + i] = 1.0 if (inside_u == gu) & (inside_v == gv) else 0.0
        n += across


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True, fastmath=REORDER)
def fill_pixels(image: Picture, box: NDArray[np.int64], table: NDArray[np.float32]) -> None:
    """PIXEL and SEEN of the pixels of a box, which may lie partly or completely outside the image."""
    if image[0].size > 0:
        _fill_pixels(image[0], box, table)
    else:
        _fill_pixels(image[1], box, table)


@register_jitable(error_model="numpy", forceinline=True, fastmath=REORDER)
def _fill_pixels(image: GrayImage, box: NDArray[np.int64], table: NDArray[np.float32]) -> None:
    height, width = image.shape
    left, across, top, down, stride = box[0], box[1], box[2], box[3], box[4]
    whole = left >= 0 and left + (across - 1) * stride < width
    n = 0
    for j in range(down):
        row = top + j * stride
        seen = np.float32(1.0) if row >= 0 and row < height else np.float32(0.0)
        line = image[min(max(row, 0), height - 1)]
        if whole and stride == 1:
            part = line[left : left + across]
            for i in range(across):
                table[PIXEL, n + i] = part[i]
                table[SEEN, n + i] = seen
        else:
            for i in range(across):
                column = left + i * stride
                within = min(max(column, 0), width - 1)
                table[PIXEL, n + i] = line[within]
                table[SEEN, n + i] = seen if within == column else np.float32(0.0)
        n += across


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True, fastmath=REORDER)
def fill_template(
    coefs: NDArray[np.float32],
    support: NDArray[np.uint8],
    cell: NDArray[np.int32],
    nearest: NDArray[np.int32],
    pixels: int,
    columns: NDArray[np.float32],
    marks: NDArray[np.uint8],
    table: NDArray[np.float32],
) -> None:
    """VALUE, SLOPE_U and SLOPE_V at the positions from `fill_positions`; WANTED restricted to the support.

    Parameters
    ----------
    columns : float32 array, shape (8 * pixels,) or more
    marks : uint8 array, shape (pixels,) or more
        Working memory.
    """
    rows, wide = coefs.shape
    flat, mask = coefs.reshape(rows * wide), support.reshape(rows * wide)
    for n in range(pixels):
        _weigh(flat, wide, np.intp(cell[n]), table[S, n], columns, 8 * n)
        marks[n] = mask[np.uint64(nearest[n])]
    one, two, three, six = np.float32(1.0), np.float32(2.0), np.float32(3.0), np.float32(6.0)
    sixth, half = one / six, one / two
    for n in range(pixels):
        t = table[T, n]
        r = one - t
        w0, w3 = r * r * r * sixth, t * t * t * sixth
        w1 = two / three - t * t * (one - half * t)
        w2 = two / three - r * r * (one - half * r)
        d0, d3 = -half * r * r, half * t * t
        d1 = t * (three * half * t - two)
        d2 = r * (two - three * half * r)
        k = 8 * n
        c0, c1, c2, c3 = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        table[VALUE, n] = w0 * c0 + w1 * c1 + w2 * c2 + w3 * c3
        table[SLOPE_U, n] = d0 * c0 + d1 * c1 + d2 * c2 + d3 * c3
        table[SLOPE_V, n] = (
            w0 * columns[k + 4] + w1 * columns[k + 5] + w2 * columns[k + 6] + w3 * columns[k + 7]
        )
        table[WANTED, n] *= np.float32(marks[n])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True, fastmath=REORDER)
def add_up(  # noqa: PLR0915 - sums in registers, written out one by one
    table: NDArray[np.float32],
    pixels: int,
    gain: float,
    offset: float,
    noise: FloatArray,
    saturation: float,
    sums: FloatArray,
) -> None:
    """Add the weighted products of all pixels to `sums`, in the order stated at `SUMS`."""
    n0, n1 = noise[0], noise[1]
    chi2 = pp = pq = qq = pv = qv = vv = po = qo = vo = oo = pt = qt = vt = ot = tt = 0.0
    rp = rq = rv = ro = rt = used = saturated = expected = 0.0
    for n in range(pixels):
        v, p, q = float(table[VALUE, n]), float(table[SLOPE_U, n]), float(table[SLOPE_V, n])
        pixel, wanted = float(table[PIXEL, n]), float(table[WANTED, n])
        model = gain * v + offset
        there = wanted * float(table[SEEN, n])
        over = there if (pixel >= saturation) | (model >= saturation) else 0.0
        counts = there - over
        expected += wanted
        saturated += over
        used += counts
        t = p * float(table[FROM_V, n]) - q * float(table[FROM_U, n])
        r = pixel - model
        # A single-precision quotient is several times faster; an error of 1e-7 in a weight is negligible.
        inverse = float(np.float32(1.0) / np.float32(n0 + n1 * max(model, 0.0)))
        w = inverse if counts > 0.0 else 0.0
        wp, wq, wv, wt, wr = w * p, w * q, w * v, w * t, w * r
        chi2 += wr * r
        pp += wp * p
        pq += wp * q
        qq += wq * q
        pv += wp * v
        qv += wq * v
        vv += wv * v
        po += wp
        qo += wq
        vo += wv
        oo += w
        pt += wp * t
        qt += wq * t
        vt += wv * t
        ot += wt
        tt += wt * t
        rp += wr * p
        rq += wr * q
        rv += wr * v
        ro += wr
        rt += wr * t
    # One by one: a temporary array would cost more.
    sums[0] += chi2
    sums[1] += pp
    sums[2] += pq
    sums[3] += qq
    sums[4] += pv
    sums[5] += qv
    sums[6] += vv
    sums[7] += po
    sums[8] += qo
    sums[9] += vo
    sums[10] += oo
    sums[11] += pt
    sums[12] += qt
    sums[13] += vt
    sums[14] += ot
    sums[15] += tt
    sums[16] += rp
    sums[17] += rq
    sums[18] += rv
    sums[19] += ro
    sums[20] += rt
    sums[21] += used
    sums[22] += saturated
    sums[23] += expected
