"""Which method can estimate what: the refusals, and the table that `noiseid methods` shows."""

from __future__ import annotations

from noiseid_cli.config.method_base import KINDS, STRUCTURES, MethodOptions
from noiseid_cli.config.methods import METHOD_OPTIONS
from noiseid_cli.config.methods_online import JointSrukfOptions
from noiseid_cli.config.schema_estimate import Estimate
from noiseid_cli.config.schema_unknowns import Blocks


def wanted(section: Estimate) -> set[str]:
    """The kinds of unknown that an ``estimate`` section asks for, of ``KINDS``."""
    asked = {
        kind for kind, place in KINDS.items() if kind != "parameters" and getattr(section, place).start is not None
    }
    return asked | ({"parameters"} if section.parameters else set())


def structures(section: Estimate, options: MethodOptions) -> set[str]:
    """The structures of the process noise's covariance that a method meets, of ``STRUCTURES``."""
    noise = section.process_noise
    if noise.start is None:
        return set()
    own = options.structure or noise.structure
    out = {"blocks" if isinstance(own, Blocks) else own}
    return out | ({"fixed"} if noise.fixed else set()) | ({"tied"} if noise.tied else set())


def refusal(options: MethodOptions, section: Estimate) -> str:
    """Why a method cannot do what is asked, with those that can; empty where it can."""
    name, asked = options.method, wanted(section)
    if isinstance(options, JointSrukfOptions) and options.hold_process_noise:
        asked -= {"Q"}
    beyond = asked - options.can
    if beyond:
        able = [other for other, o in METHOD_OPTIONS.items() if asked <= o.can]
        places = " and ".join(f"estimate.{KINDS[kind]}" for kind in KINDS if kind in beyond)
        asks = "asks" if len(beyond) == 1 else "ask"
        return f"{name} cannot estimate what {places} {asks} for: give it as known{_or_take(able)}"
    if "Q" not in asked and options.can == {"Q"}:
        able = [other for other, o in METHOD_OPTIONS.items() if asked <= o.can and o.can != {"Q"}]
        return f"{name} estimates the process noise, which is known here: give process_noise a start{_or_take(able)}"
    met = structures(section, options) if "Q" in asked else set()
    if met - options.structures:
        able = [other for other, o in METHOD_OPTIONS.items() if asked <= o.can and met <= o.structures]
        allowed = ", ".join(s for s in STRUCTURES if s in options.structures)
        odd = ", ".join(s for s in STRUCTURES if s in met - options.structures)
        return f"{name} takes a process noise of structure {allowed}, not {odd}: change that{_or_take(able)}"
    return ""


def _or_take(able: list[str]) -> str:
    return f", or take a method that can: {', '.join(able)}" if able else "; no method estimates all that is asked"
