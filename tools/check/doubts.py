"""Facts about the device on which safety rests and which are not sure; a test holds them against the table.

The words of a fact and its confidence are those of docs/fidelity.md.
"""

from typing import NamedTuple


class Doubt(NamedTuple):
    """One fact."""

    fact: str
    """First column of the fidelity table."""
    confidence: str
    """M one source; L inferred, or quoted from memory; C unknown, our choice."""
    consequence: str
    """What it would mean if it were otherwise."""


DOUBTS = (
    Doubt(
        "what happens when a client vanishes",
        "C",
        "when the link is cut the device may go on with its last effects: only the emergency button is left",
    ),
    Doubt("a `stop` disables effects", "L", "an effect may act again when the state is left"),
    Doubt("new objects are disabled", "L", "an effect may act from the moment at which it is made"),
    Doubt(
        "`calibrateforcesensor` zeroes the sensor",
        "M",
        "a wrong zero makes the arm drift although nobody touches it",
    ),
    Doubt("1.0 m/s", "L", "the arm may be faster than we think"),
    Doubt("nominal and largest force 100 and 250 N", "L", "the arm may push harder than we think"),
    Doubt("a velocity guard exists", "M", "the device itself may not stop a fast arm"),
    Doubt("what happens at an end stop", "C", "the arm may hit it hard"),
    Doubt("which state may follow which", "C", "a stop may be refused in a state that we do not know"),
    Doubt(
        "names of objects that do not exist pass silently",
        "M",
        "a command for an effect may do nothing without a word",
    ),
    Doubt("several clients", "C", "the guardian may get no connection of its own; then no session starts"),
)
