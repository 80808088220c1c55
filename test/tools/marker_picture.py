"""A MarkerArray as a display would show it from above, by its message alone."""

from __future__ import annotations

from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from visualization_msgs.msg import Marker

INCH = 0.0254
MARGIN = 0.02  # m


def shown(messages: list[Any]) -> dict[tuple[str, int], Marker]:
    """What stands on the display after these messages, by (ns, id)."""
    markers: dict[tuple[str, int], Marker] = {}
    for message in messages:
        for marker in message.markers:
            if marker.action == Marker.DELETEALL:
                markers.clear()
            elif marker.action == Marker.DELETE:
                markers.pop((marker.ns, marker.id), None)
            else:
                markers[marker.ns, marker.id] = marker
    return markers


def draw(markers: dict[tuple[str, int], Marker], background: str = "#303030") -> Figure:
    """The picture, to scale: lines and dots as wide in metres as the markers say."""
    figure = Figure(figsize=(7.0, 7.0), facecolor=background)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), facecolor=background)
    points = [
        (point.x, point.y) for marker in markers.values() for point in marker.points
    ]
    low = [min(point[axis] for point in points) - MARGIN for axis in (0, 1)]
    high = [max(point[axis] for point in points) + MARGIN for axis in (0, 1)]
    span = max(high[0] - low[0], high[1] - low[1])
    dots = 7.0 * 72.0 / span  # points of the picture for each metre
    for marker in sorted(
        markers.values(),
        key=lambda marker: max([point.z for point in marker.points], default=0.0),
    ):
        color = (marker.color.r, marker.color.g, marker.color.b, marker.color.a)
        x, y = (
            [point.x for point in marker.points],
            [point.y for point in marker.points],
        )
        if marker.type == Marker.LINE_LIST:
            for k in range(0, len(x), 2):
                axes.plot(
                    x[k : k + 2],
                    y[k : k + 2],
                    color=color,
                    linewidth=marker.scale.x * dots,
                )
        elif marker.type == Marker.LINE_STRIP:
            axes.plot(x, y, color=color, linewidth=marker.scale.x * dots)
        elif marker.type == Marker.SPHERE_LIST:
            axes.plot(x, y, "o", color=color, markersize=marker.scale.x * dots)
        elif marker.type == Marker.ARROW:
            style = {
                "arrowstyle": "-|>",
                "color": color,
                "linewidth": marker.scale.x * dots,
            }
            axes.annotate("", (x[1], y[1]), (x[0], y[0]), arrowprops=style)
        elif marker.type == Marker.TEXT_VIEW_FACING:
            at = marker.pose.position
            axes.text(
                at.x,
                at.y,
                marker.text,
                color=color,
                fontsize=marker.scale.z * dots * 0.7,
                ha="center",
                va="center",
            )
    axes.set_xlim(low[0], low[0] + span)
    axes.set_ylim(low[1], low[1] + span)
    return figure
