"""Pages of metrics, of knobs, and of what the models take for granted."""

from dataclasses import fields

from tables import table

from hardware.units import unit_of
from twin.fidelity import PRESETS, Fidelity, LightFidelity, RadarFidelity
from twin.schemas import documented
from twin.sweep.names import CLOSED_FORM, ERRORS, RENDERED


def metrics_page() -> str:
    """What a study may measure."""
    text = (
        "# Metrics\n\nWhat a [study](file-study.md) measures of each point. A function of one's "
        "own, `file.py:function`, takes a `twin.sweep.metrics.Outcome`.\n"
    )
    for title, known in (
        ("Rendered points", RENDERED),
        ('Closed form, `model = "closed-form"`', CLOSED_FORM),
    ):
        rows = [
            (
                f"`{n}`",
                "" if m.unit == "1" else m.unit,
                m.meaning,
                "radar" if m.of_radar else "camera",
            )
            for n, m in known.items()
        ]
        text += f"\n## {title}\n\n" + table(("metric", "unit", "what it is", "sensor"), rows)
    text += "\nOf each rendered metric `NAME` there are further columns:\n\n"
    return text + table(
        ("column", "what it is"), ((f"`NAME.{kind}`", said) for kind, said in ERRORS.items())
    )


def knobs_page() -> str:
    """Knobs of fidelity with their presets."""
    text = (
        "# Knobs of fidelity\n\nFields of `twin.Fidelity`, in a study `fidelity.KNOB`. Each bounds "
        "an error; see [fidelity and tolerance](../../explanation/fidelity.md).\n"
    )
    for title, kind in (("Light", LightFidelity), ("Radar", RadarFidelity)):
        meanings = documented(kind)
        rows = [
            (
                f"`{field.name}`",
                unit_of(field.name) or "",
                *(_value(getattr(knobs, field.name)) for knobs in (Fidelity(), *PRESETS.values())),
                meanings[field.name],
            )
            for field in fields(kind)
        ]
        heads = ("knob", "unit", "value alone", *(f"`{name}`" for name in PRESETS), "meaning")
        text += f"\n## {title}\n\n" + table(heads, rows)
    return text


def assumptions_page() -> str:
    """What the models say of themselves, whatever the scene and the design."""
    from twin.camera.assumptions import (
        MODEL_ASSUMPTIONS,
        MOVING_ASSUMPTION,
        SKY_STAYS_ASSUMPTION,
        STILL_ASSUMPTION,
        SUN_MOVES_ASSUMPTION,
    )
    from twin.radar.diagnostics import MODEL_ASSUMPTIONS as OF_THE_RADAR
    from twin.radar.propagation.solvers import SOLVERS

    rows = [
        ("camera", MODEL_ASSUMPTIONS),
        ("camera, at rest", (STILL_ASSUMPTION,)),
        ("camera, where things move", (MOVING_ASSUMPTION,)),
        ("camera, where the sun moves", (SUN_MOVES_ASSUMPTION,)),
        ("the same, of a system with a sky", (SKY_STAYS_ASSUMPTION,)),
        ("radar", OF_THE_RADAR),
        *((f"radar, `{name}`", solver.assumptions) for name, solver in SOLVERS.items()),
    ]
    return (
        "# What each result says\n\nAssumptions that the models print with every result, before "
        "those of the scene and of the design.\n\n"
        + table(
            ("model", "takes for granted"), ((who, said) for who, all_ in rows for said in all_)
        )
    )


def _value(value: object) -> str:
    return f"`{value}`"
