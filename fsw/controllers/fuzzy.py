"""Fuzzy inference of three outputs from two inputs: Mamdani rules, weighted average, exactly and in closed form."""

from __future__ import annotations

from bus.units import Vec3
from fsw.controllers.fuzzy_tables import Rules


class FuzzyTables:
    """F = sum mu_r c_r / sum mu_r over the rules of three 7x7 tables that share their two inputs.

    Inputs on [-1, 1], saturated outside: seven triangles with centres -1, -2/3 .. 1 and half-width 1/3. Outputs are the
    singletons l/3, l the table's level -3 .. 3, so that F is within [-1, 1]. AND is the smaller ("min") or the product
    ("prod") of the two memberships.

    The triangles overlap in pairs and their sum is 1: an input belongs to two of them at most, and of the 49 rules the four
    around the point are all that count. With "prod" the sum of the memberships is 1, and F the bilinear interpolation of
    the table.
    """

    __slots__ = ("_cells", "_product")

    def __init__(self, rules: tuple[Rules, Rules, Rules], product: bool) -> None:
        """rules: levels -3 .. 3 of the outputs, shape (3, 7, 7); rows over the first input, columns over the second."""
        first, second, third = rules
        self._product = product
        self._cells: list[Vec3] = [
            (first[row][column] / 3.0, second[row][column] / 3.0, third[row][column] / 3.0)
            for row in range(7)
            for column in range(7)
        ]

    def infer(self, e: float, ec: float) -> Vec3:
        """Return the three outputs, each within [-1, 1]. What is not a number counts as -1."""
        x = 3.0 * e + 3.0 if -1.0 <= e <= 1.0 else (6.0 if e > 1.0 else 0.0)
        y = 3.0 * ec + 3.0 if -1.0 <= ec <= 1.0 else (6.0 if ec > 1.0 else 0.0)
        row = int(x) if x < 6.0 else 5
        column = int(y) if y < 6.0 else 5
        down, right = x - row, y - column  # memberships of the upper neighbours; those of the lower are the rest to 1
        up, left = 1.0 - down, 1.0 - right
        if self._product:
            a, b, c, d = up * left, up * right, down * left, down * right
        else:
            a = up if up < left else left
            b = up if up < right else right
            c = down if down < left else left
            d = down if down < right else right
        total = a + b + c + d  # at least 1
        cells, at = self._cells, 7 * row + column
        ap, ai, ad = cells[at]
        bp, bi, bd = cells[at + 1]
        cp, ci, cd = cells[at + 7]
        dp, di, dd = cells[at + 8]
        return (
            (a * ap + b * bp + c * cp + d * dp) / total,
            (a * ai + b * bi + c * ci + d * di) / total,
            (a * ad + b * bd + c * cd + d * dd) / total,
        )
