"""From the configuration of a corner to its network, with effects and wear."""

from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.effects.catalogue import apply_effects, effects_of
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.brake_corner import build_corner, corner_spec
from bstm_daemon.model.thermal.program import Program, compile_network
from bstm_daemon.model.wear.dose import with_wear_memories


def compile_corner(config: Config, corner: CornerConfig) -> Program:
    """Network of *corner* with its effects, compiled.

    Raises:
        ConfigError: a part, share or effect that does not exist or fit.
    """
    return compiled_model(corner_model(config, corner))


def compiled_model(model: CornerModel) -> Program:
    """Network of *model*, compiled.

    Raises:
        ConfigError: the effects do not fit together.
    """
    try:
        return compile_network(model.network)
    except (KeyError, ValueError) as error:
        msg = f"[[corner]] {model.spec.name} with its effects: {error}"
        raise ConfigError([msg]) from error


def corner_model(config: Config, corner: CornerConfig) -> CornerModel:
    """Network and friction law of *corner* with its effects.

    Raises:
        ConfigError: a part, share or effect that does not exist or fit.
    """
    spec = corner_spec(config, corner)
    mode = config.heat.mode
    try:
        model = CornerModel(
            spec,
            build_corner(spec, CHANNELS, force_measured=mode == "measured"),
            mode not in {"fb", "fused"},
            config.vehicle.wheel_radius_m,
        )
        model = apply_effects(model, effects_of(config))
        return model.with_network(
            with_wear_memories(model.network, config, corner)
        )
    except (KeyError, ValueError) as error:
        msg = f"[[corner]] {corner.name} with its effects: {error}"
        raise ConfigError([msg]) from error
