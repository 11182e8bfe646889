"""Systems and front ends with single values changed."""

from twin.detector import FrontEnd
from twin.system import System, load_system

#: An electron per watt and a count per electron: nothing but shot noise.
QUIET = FrontEnd(
    electrons_per_watt=1.0,
    dark_e=0.0,
    johnson_e=0.0,
    read_e=0.0,
    electrons_per_count=1.0,
    offset_counts=0.0,
    adc_bits=31,
)


def changed(system: System | str = "workable", **values: float | str) -> System:
    """A system with single values replaced, by dotted name with ``__`` for the dot."""
    made = load_system(system) if isinstance(system, str) else system
    content = made.model_dump()
    for name, value in values.items():
        section, field = name.split("__")
        content[section][field] = value
    return System.model_validate(content)
