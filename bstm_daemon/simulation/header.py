"""What the compiled reality takes from Python: sizes, names, parameters."""

from bstm_daemon.native.header import Header
from bstm_daemon.simulation import parameters, sizes


def generated_header() -> str:
    """Return the text of ``reality.h``."""
    header = Header()
    header.constants(parameters, sizes)
    header.names("", parameters.LUMPS, "LUMPS")
    header.names("in_", parameters.INPUT_NAMES, "INPUTS")
    for name, members, more in (
        ("DrawnPath", parameters.PATH_NAMES, ""),
        ("Parameters", parameters.PARAMETER_NAMES, " DrawnPath drawn[DRAWN];"),
    ):
        doubles = ", ".join(members)
        header.lines.append(
            f"typedef struct {{ double {doubles};{more} }} {name};"
        )
    return header.text()
