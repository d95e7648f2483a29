"""What the compiled forms of heat and temperatures take from Python."""

from bstm_daemon import channels, roles, units
from bstm_daemon.model.heat import (
    check_rules,
    friction_law,
    fusion,
    inputs,
    learned,
    memory,
    observer,
    observer_faults,
    observer_rules,
    readings,
    sample_pass,
    sample_plan,
)
from bstm_daemon.model.thermal import program, reference
from bstm_daemon.native.header import Header
from bstm_daemon.native.sources import PACKAGE


def generated_header() -> str:
    """Return the text of ``generated.h``."""
    header = Header()
    names = [role.name for role in roles.ROLES]
    header.names("role_", names, "ROLES")
    header.names("node_", roles.MEASURED_NODES, "MEASURED_COUNT")
    header.names("channel_", channels.CHANNELS, "CHANNELS")
    header.names("vehicle_", channels.VEHICLE_CHANNELS, "VEHICLE_CHANNELS")
    header.values_of("flag_", channels.FLAGS)
    header.values_of("mode_", channels.MODES)
    header.values_of("slope_", channels.SLOPES)
    header.constants(
        roles,
        channels,
        units,
        check_rules,
        friction_law,
        learned,
        memory,
        observer_rules,
        observer,
        inputs,
        fusion,
        sample_pass,
    )
    header.layout(sample_plan.PlanNumbers)
    header.layout(memory.SampleMemory)
    header.record(observer_faults.Step)
    header.record(readings.Readings)
    header.constants(program, reference)
    header.names("count_", program.COUNTS, "COUNTS")
    header.names("", program.SECTIONS, "SECTIONS")
    header.values_of("driver_", program.DRIVER_KINDS)
    header.values_of("memory_", program.MEMORY_KINDS)
    return header.text()


def c_sources(*, heat: bool) -> dict[str, bytes]:
    """Return C files and headers by name, of temperatures and of *heat*."""
    rooms = ("thermal", "heat") if heat else ("thermal",)
    return {"generated.h": generated_header().encode()} | {
        file.name: file.read_bytes()
        for room in rooms
        for file in (PACKAGE / "native" / room).glob("*.[ch]")
    }
