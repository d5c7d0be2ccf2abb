"""SVG pictures in panels: text, arrows, the symbols of mechanics, and axes with curves.

Coordinates of a picture are pixels, y downward; angles of arcs are in degrees, counterclockwise from the x axis. Text between backticks is
monospaced, as names of a mechanism file are in the documentation. The same calls give the same bytes.
"""

import math
from xml.sax.saxutils import escape

INK, GREY, BLUE, ORANGE, GREEN, SKY, FILL = "#222222", "#888888", "#0072B2", "#D55E00", "#00805C", "#56B4E9", "#E3EAF2"
FONT = "Arial, Helvetica, 'Liberation Sans', sans-serif"
MONOSPACED = "Consolas, Menlo, 'DejaVu Sans Mono', 'Liberation Mono', monospace"
# arrowheads, in pixels
HEAD, HALF_HEAD = 9.0, 3.5


def number(value):
    """A coordinate in as few digits as its hundredths need; what rounding changes in the last bits changes no digit."""
    text = f"{round(value, 6):.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def path(points):
    return " ".join(f"{number(x)},{number(y)}" for x, y in points)


def around(x, y, radius, degrees):
    return x + radius * math.cos(math.radians(degrees)), y - radius * math.sin(math.radians(degrees))


class Picture:
    """A picture with a white background, which dark viewers show too."""

    def __init__(self, title, width=960, height=290):
        self.width, self.height = width, height
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" role="img" '
            f'font-family="{FONT}" font-size="12" fill="{INK}" stroke-linejoin="round">',
            f"<title>{escape(title)}</title>",
            f"<style>.m{{font-family:{MONOSPACED};font-size:92%}}.h{{paint-order:stroke;stroke:#FFFFFF;stroke-width:3px}}</style>",
            f'<rect width="{width}" height="{height}" rx="6" fill="#FFFFFF"/>',
        ]

    def svg(self):
        return "\n".join([*self.parts, "</svg>"]) + "\n"

    def text(self, x, y, text, color=INK, anchor="start", size=12, bold=False, halo=False):
        pieces = escape(text).split("`")
        content = "".join(f'<tspan class="m">{piece}</tspan>' if k % 2 else piece for k, piece in enumerate(pieces))
        more = (f' fill="{color}"' if color != INK else "") + (f' text-anchor="{anchor}"' if anchor != "start" else "")
        more += (f' font-size="{size}"' if size != 12 else "") + (' font-weight="bold"' if bold else "") + (' class="h"' if halo else "")
        self.parts.append(f'<text x="{number(x)}" y="{number(y)}"{more}>{content}</text>')

    def line(self, *points, color=INK, width=1.5, dash=None, fill="none", closed=False):
        kind = "polygon" if closed else "polyline"
        more = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(f'<{kind} points="{path(points)}" fill="{fill}" stroke="{color}" stroke-width="{width}"{more}/>')

    def circle(self, x, y, radius, fill=FILL, color=INK, width=1.5, dash=None):
        more = f' stroke-dasharray="{dash}"' if dash else ""
        where = f'cx="{number(x)}" cy="{number(y)}" r="{number(radius)}"'
        self.parts.append(f'<circle {where} fill="{fill}" stroke="{color}" stroke-width="{width}"{more}/>')

    def box(self, x, y, width, height, fill=FILL, color=INK, dash=None):
        """A rectangle around its center."""
        left, right, top, bottom = x - width / 2, x + width / 2, y - height / 2, y + height / 2
        self.line((left, top), (right, top), (right, bottom), (left, bottom), closed=True, fill=fill, color=color, dash=dash)

    def bar(self, x0, y0, x1, y1, width=12, fill=FILL, color=INK, dash=None):
        """A link with round ends."""
        along, half = math.degrees(math.atan2(y0 - y1, x1 - x0)), width / 2
        end = [around(x1, y1, half, along - 90 + 15 * k) for k in range(13)]
        start = [around(x0, y0, half, along + 90 + 15 * k) for k in range(13)]
        self.line(*end, *start, closed=True, fill=fill, color=color, dash=dash)

    def head(self, x, y, degrees, color):
        """An arrowhead whose tip is at x, y."""
        back = around(x, y, HEAD, degrees + 180)
        self.line(
            (x, y), around(*back, HALF_HEAD, degrees + 90), around(*back, HALF_HEAD, degrees - 90), closed=True, fill=color, color=color, width=0.5
        )

    def arrow(self, x0, y0, x1, y1, color=ORANGE, width=2, both=False):
        degrees = math.degrees(math.atan2(y0 - y1, x1 - x0))
        start = around(x0, y0, HEAD - 1, degrees) if both else (x0, y0)
        self.line(start, around(x1, y1, HEAD - 1, degrees + 180), color=color, width=width)
        self.head(x1, y1, degrees, color)
        if both:
            self.head(x0, y0, degrees + 180, color)

    def turn(self, x, y, radius, start, end, color=ORANGE, width=2):
        """An arrow along an arc."""
        back = math.degrees((HEAD - 1) / radius) * (1 if end > start else -1)
        count = max(8, round(abs(end - start) / 6))
        self.line(*(around(x, y, radius, start + (end - back - start) * k / count) for k in range(count + 1)), color=color, width=width)
        # a chord of the arc is steeper than its tangent at the tip
        self.head(*around(x, y, radius, end), end + (90 if end > start else -90) - back / 2, color)

    def spring(self, x0, y0, x1, y1, coils=6, half=7, color=INK):
        """A zigzag with straight ends."""
        length, degrees = math.hypot(x1 - x0, y1 - y0), math.degrees(math.atan2(y0 - y1, x1 - x0))
        lead = min(12.0, length / 6)
        points = [(0, 0), (lead, 0)]
        pitch = (length - 2 * lead) / (2 * coils)
        points += [(lead + pitch * (k + 0.5), half if k % 2 else -half) for k in range(2 * coils)]
        points += [(length - lead, 0), (length, 0)]
        self.line(*(self.moved(x0, y0, degrees, *point) for point in points), color=color)

    def damper(self, x0, y0, x1, y1, half=8, color=INK):
        """A piston in a cylinder that is open toward the second end."""
        length, degrees = math.hypot(x1 - x0, y1 - y0), math.degrees(math.atan2(y0 - y1, x1 - x0))
        place = lambda along, across: self.moved(x0, y0, degrees, along, across)
        first, last, piston = length * 0.33, length * 0.62, length * 0.52
        self.line(place(0, 0), place(first, 0), color=color)
        self.line(place(last, half), place(first, half), place(first, -half), place(last, -half), color=color)
        self.line(place(piston, half - 2), place(piston, 2 - half), color=color, width=2.5)
        self.line(place(piston, 0), place(length, 0), color=color)

    @staticmethod
    def moved(x, y, degrees, along, across):
        return around(*around(x, y, along, degrees), across, degrees + 90)

    def ground(self, x0, y0, x1, y1):
        """A fixed edge, hatched on the right of the direction from its first end to its second."""
        length, degrees = math.hypot(x1 - x0, y1 - y0), math.degrees(math.atan2(y0 - y1, x1 - x0))
        count = max(2, round(length / 9))
        for k in range(count):
            near = self.moved(x0, y0, degrees, length * (k + 1) / count, 0)
            far = self.moved(x0, y0, degrees, length * (k + 0.2) / count, -8)
            self.line(near, far, color=GREY, width=1)
        self.line((x0, y0), (x1, y1), width=2)

    def hinge(self, x, y):
        """A revolute joint."""
        self.circle(x, y, 4, fill="#FFFFFF")

    def wall_hinge(self, x, y):
        """A revolute joint on a wall to its left, with a spiral spring."""
        self.ground(x - 34, y + 40, x - 34, y - 40)
        self.line((x - 34, y), (x, y), width=2)
        self.spiral(x, y, 9, 20)
        self.hinge(x, y)

    def spiral(self, x, y, first, last):
        """A torsion spring of two turns."""
        self.line(*(around(x, y, first + (last - first) * k / 48, 15 * k) for k in range(49)))

    def mark(self, x, y, color=INK):
        """A named point."""
        self.circle(x, y, 2.5, fill=color, color=color)

    def dimension(self, x0, y0, x1, y1):
        """A length between two arrowheads."""
        self.arrow(x0, y0, x1, y1, color=GREY, width=1, both=True)

    def axes(self, left, top, width, height, x, y, **options):
        return Axes(self, left, top, width, height, x, y, **options)


def round_steps(low, high, most=6):
    """Round numbers that divide a range into at most `most` parts."""
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= raw * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def written(value):
    return f"{value:.10g}".replace("-", "−")


class Axes:
    """A frame with ticks. Ranges are (low, high); ticks are numbers, or pairs of a number and a text."""

    def __init__(self, picture, left, top, width, height, x, y, x_label="", y_label="", x_ticks=None, y_ticks=None, zero=True):
        self.picture, self.frame, self.x, self.y = picture, (left, top, width, height), x, y
        picture.line((left, top), (left, top + height), (left + width, top + height), (left + width, top), color="#BBBBBB", width=1, closed=True)
        ticks = lambda given, limits: [
            tick if isinstance(tick, tuple) else (tick, written(tick)) for tick in (round_steps(*limits) if given is None else given)
        ]
        for value, text in ticks(x_ticks, x):
            at = self.at(value, y[0])[0]
            picture.line((at, top), (at, top + height), color="#E6E6E6", width=1)
            picture.text(at, top + height + 15, text, anchor="middle", size=11)
        for value, text in ticks(y_ticks, y):
            at = self.at(x[0], value)[1]
            picture.line((left, at), (left + width, at), color="#E6E6E6", width=1)
            picture.text(left - 5, at + 4, text, anchor="end", size=11)
        if zero and y[0] < 0 < y[1]:
            self.line([x[0], x[1]], [0, 0], color=GREY, width=1)
        if zero and x[0] < 0 < x[1]:
            self.line([0, 0], [y[0], y[1]], color=GREY, width=1)
        if x_label:
            picture.text(left + width, top + height + 31, x_label, anchor="end")
        picture.text(left, top - 7, y_label)

    def at(self, x, y):
        left, top, width, height = self.frame
        return left + width * (x - self.x[0]) / (self.x[1] - self.x[0]), top + height * (self.y[1] - y) / (self.y[1] - self.y[0])

    def line(self, xs, ys, color=BLUE, width=2, dash=None):
        points = [self.at(x, y) for x, y in zip(xs, ys, strict=True)]
        left, top, wide, high = self.frame
        outside = [p for p in points if not (left - 1 <= p[0] <= left + wide + 1 and top - 1 <= p[1] <= top + high + 1)]
        assert not outside, f"a curve leaves its axes at {outside[0]}"
        self.picture.line(*points, color=color, width=width, dash=dash)

    def circle(self, x, y, radius=3, color=INK):
        self.picture.circle(*self.at(x, y), radius, fill="none", color=color, width=1.2)

    def compare(self, xs, curve, exact, color=INK, every=1):
        """Circles at the reference of a curve, which must be the same to a millionth of its largest value."""
        off, largest = max(abs(a - b) for a, b in zip(curve, exact, strict=True)), max(map(abs, exact))
        assert off <= 1e-6 * largest, f"a curve is off its reference by {off:.1e} of {largest:.1e}"
        for x, y in list(zip(xs, exact, strict=True))[::every]:
            self.circle(x, y, color=color)

    def dots(self, xs, ys, color=INK, radius=3.2):
        for x, y in zip(xs, ys, strict=True):
            self.picture.circle(*self.at(x, y), radius, fill=color, color="#FFFFFF", width=1)

    def cloud(self, xs, ys, color=BLUE, size=2.4):
        """Many dots as one path, whose parts have length zero and round ends."""
        moves = "".join(f"M{number(at[0])} {number(at[1])}h0" for at in (self.at(x, y) for x, y in zip(xs, ys, strict=True)))
        self.picture.parts.append(f'<path d="{moves}" fill="none" stroke="{color}" stroke-width="{size}" stroke-linecap="round"/>')

    def text(self, x, y, text, color=INK, anchor="start", dx=0, dy=0):
        at = self.at(x, y)
        self.picture.text(at[0] + dx, at[1] + dy, text, color=color, anchor=anchor, size=11.5, halo=True)

    def key(self, x, y, *entries):
        """A legend from a point of the data downward: pairs of a text and "line", "dash" or "circle" with a color."""
        left, top = self.at(x, y)
        for k, (text, kind, color) in enumerate(entries):
            at = top + 16 * k
            if kind == "circle":
                self.picture.circle(left + 10, at - 4, 3, fill="none", color=color, width=1.2)
            else:
                self.picture.line((left, at - 4), (left + 20, at - 4), color=color, width=2, dash="5 4" if kind == "dash" else None)
            self.picture.text(left + 26, at, text, size=11.5, halo=True)
