"""Charts of the decay view: options of ECharts from what was found."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from modalcam.studio.decay import Decay

# Legible on light and on dark ground.
_INK, _CURVE, _MARK = "#808a93", "#0a8f6a", "#d0568f"
# Fill of a part of the record; its kind is written in it.
_FILLS = {"decay": "#0a8f6a26", "driven": "#e69f0026"}
_OTHER_FILL = "#80808040"
# Part of the record, as a share of it, from which on its name is shown.
_LEAST_NAMED = 0.08
_POLES = {True: "stable pole", False: "other pole"}


def chart(options: dict[str, Any], name: str) -> Any:
    """A chart with a name for a screen reader."""
    element = ui.echart(options).classes("chart").props('role="img"')
    element.props["aria-label"] = name
    return element


def _options(x_name: str, y_name: str, points: tuple[tuple[float, float], ...], scale: str) -> dict[str, Any]:
    axis = {
        "nameLocation": "middle",
        "axisLine": {"lineStyle": {"color": _INK}},
        "axisLabel": {"color": _INK, "showMaxLabel": False},
        "splitLine": {"show": False},
    }
    return {
        "animation": False,
        "grid": {"left": 80, "right": 20, "top": 30, "bottom": 50},
        "xAxis": {"type": "value", "name": x_name, "nameGap": 28, "min": "dataMin", "max": "dataMax", **axis},
        "yAxis": {"type": scale, "name": y_name, "nameGap": 60, **axis},
        "dataZoom": [{"type": "inside"}],
        "series": [
            {
                "type": "line",
                "data": [list(point) for point in points],
                "showSymbol": False,
                "lineStyle": {"width": 1, "color": _CURVE},
            }
        ],
    }


def curve_options(decay: Decay) -> dict[str, Any]:
    """Displacement over time, with the parts of the record."""
    options = _options("time / s", f"displacement / {decay.unit}", decay.curve, "value")
    # Names of short parts would lie over each other.
    least_s = _LEAST_NAMED * (decay.span_s[1] - decay.span_s[0])
    options["series"][0]["markArea"] = {
        "label": {"color": _INK},
        "data": [
            [
                {
                    "xAxis": start,
                    "name": kind if end - start > least_s else "",
                    "itemStyle": {"color": _FILLS.get(kind, _OTHER_FILL)},
                },
                {"xAxis": end},
            ]
            for kind, start, end in decay.parts
        ],
    }
    return options


def spectrum_options(decay: Decay) -> dict[str, Any]:
    """Spectrum with lines at the modes, and the poles of the stabilisation chart."""
    # A logarithmic axis has no zero.
    points = tuple((f, a) for f, a in decay.spectrum if a > 0.0)
    options = _options("frequency / Hz", f"amplitude / {decay.unit}", points, "log")
    options["series"][0]["markLine"] = {
        "symbol": "none",
        "lineStyle": {"color": _MARK, "type": "dashed"},
        "data": [
            {
                "xAxis": mode.frequency_hz,
                # Along the line: beside each other, the names of close modes would overlap.
                "label": {
                    "formatter": f"{mode.frequency_hz:.4g} Hz",
                    "color": _INK,
                    "position": "insideEndTop",
                },
            }
            for mode in decay.modes
        ],
    }
    if decay.poles:
        options["yAxis"] = [
            options["yAxis"],
            {
                "type": "value",
                "name": "model order",
                "nameLocation": "middle",
                "nameGap": 30,
                "nameTextStyle": {"color": _INK},
                "axisLine": {"lineStyle": {"color": _INK}},
                "axisLabel": {"color": _INK},
                "splitLine": {"show": False},
            },
        ]
        options["grid"]["right"] = 60
        options["legend"] = {
            "bottom": 0,
            "right": 60,
            "textStyle": {"color": _INK},
            "data": [*_POLES.values()],
        }
        options["series"] += [_poles(decay, is_stable=stable) for stable in (True, False)]
    return options


def _poles(decay: Decay, *, is_stable: bool) -> dict[str, Any]:
    return {
        "type": "scatter",
        "name": _POLES[is_stable],
        "yAxisIndex": 1,
        "symbol": "circle" if is_stable else "emptyCircle",
        "symbolSize": 6 if is_stable else 4,
        "itemStyle": {"color": _MARK if is_stable else _INK},
        "data": [[pole.frequency_hz, pole.order] for pole in decay.poles if pole.is_stable == is_stable],
    }
