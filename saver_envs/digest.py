"""Digest of a world: what determines an episode's physics and rules, as a short text.

Results carry it, so that figures of different worlds are not mixed. It is the same on every
machine: numbers of the compiled model, which differ in their last bits between processors, are
rounded, and what MuJoCo derives for its own use is left out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.registration import default_options, task_and_settings
from saver_envs.scenes import Arms, compose

#: Fields of ``MjModel`` that determine motion and contact.
MODEL_FIELDS: Final = (
    *("qpos0", "qpos_spring", "body_parentid", "body_pos", "body_quat", "body_mass", "body_ipos"),
    *("body_iquat", "body_inertia", "body_gravcomp", "body_invweight0"),
    *("jnt_type", "jnt_bodyid", "jnt_pos", "jnt_axis", "jnt_limited", "jnt_range", "jnt_margin"),
    *("jnt_stiffness", "jnt_solref", "jnt_solimp", "jnt_actfrclimited", "jnt_actfrcrange"),
    *("dof_armature", "dof_damping", "dof_frictionloss", "dof_solref", "dof_solimp"),
    *("geom_type", "geom_bodyid", "geom_pos", "geom_quat", "geom_size", "geom_friction"),
    *("geom_contype", "geom_conaffinity", "geom_condim", "geom_priority", "geom_margin"),
    *("geom_gap", "geom_solref", "geom_solimp", "geom_solmix", "mesh_vert", "hfield_data"),
    *("site_bodyid", "site_pos", "site_quat", "exclude_signature"),
    *("pair_geom1", "pair_geom2", "pair_dim", "pair_friction", "pair_margin", "pair_solref"),
    *("eq_type", "eq_obj1id", "eq_obj2id", "eq_active0", "eq_data", "eq_solref", "eq_solimp"),
    *("tendon_range", "tendon_stiffness", "tendon_damping", "tendon_frictionloss", "wrap_prm"),
    *("actuator_trntype", "actuator_trnid", "actuator_gear", "actuator_dyntype"),
    *("actuator_dynprm", "actuator_gaintype", "actuator_gainprm", "actuator_biastype"),
    *("actuator_biasprm", "actuator_ctrllimited", "actuator_ctrlrange"),
    *("actuator_forcelimited", "actuator_forcerange"),
)
#: Its options that do.
PHYSICS_OPTIONS: Final = (
    *("timestep", "gravity", "integrator", "cone", "impratio", "solver", "iterations"),
    *("ls_iterations", "noslip_iterations", "tolerance", "disableflags", "enableflags"),
    *("density", "viscosity", "wind"),
)
#: What a task and its control always contribute; other options do where they are not the default,
#: so that an option that a later version adds leaves the digests of the worlds without it alone.
RULES: Final = (
    *("n_arms", "reward_type", "success_threshold", "fingers", "held_height", "costs", "summed"),
    *("hard", "constraint", "keeps_to_table", "horizon", "max_speed", "limit_joint_speed"),
    *("control", "bounded_observations"),
)
_HEX_DIGITS = 16
#: Significant digits of a number, and what counts as 0: a hundred thousandth of a difference that
#: matters, and a hundred thousand times the difference between processors.
_DIGITS, _ZERO = 6, 1e-9


def world_digest(env_id: str, options: Mapping[str, Any] | None = None) -> str:
    """Return the digest of an id with these keyword arguments.

    The code of a task is not part of it: a task whose starts or rewards change needs a new version.

    :param env_id: a registered id.
    :param options: keyword arguments of the environment.
    :return: 16 hexadecimal digits.
    :raises ValueError: for an unknown id or an option out of range.
    :raises TypeError: for an unknown option.
    """
    options = dict(options or {})
    task, settings = task_and_settings(env_id, options)
    arms = Arms(settings.robot, task.n_arms, task.fingers, task.bases)
    scene = compose(arms, task)
    world = {
        "id": env_id.rpartition(":")[2],
        "robot": settings.robot.name,
        "rules": {
            # The settings' horizon counts, not the task's default.
            name: plain(getattr(settings if hasattr(settings, name) else task, name))
            for name in RULES
        },
        "options": changed_options(env_id, options),
        "models": [model_digest(model) for model in scene.models],
    }
    if settings.randomization:  # by what it means, since presets may change
        world["randomization"] = settings.randomization.as_json()
    text = json.dumps(world, sort_keys=True, allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_HEX_DIGITS]


def changed_options(env_id: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments that differ from an id's defaults and are no rule, as JSON."""
    defaults = {name: plain(value) for name, value in default_options(env_id).items()}
    resolved = {*RULES, "max_episode_steps", "rated", "collision_force", "randomization"}
    given = {name: plain(value) for name, value in options.items() if name not in resolved}
    return {name: value for name, value in given.items() if value != defaults.get(name)}


def model_digest(model: mujoco.MjModel) -> str:
    """Return a digest of what determines motion and contact in a compiled model."""
    found = hashlib.sha256()
    values = {name: getattr(model, name) for name in MODEL_FIELDS}
    values |= {name: getattr(model.opt, name) for name in PHYSICS_OPTIONS}
    for name, value in values.items():
        array = np.asarray(value)
        found.update(f"{name}{array.shape}:{_rounded(array)};".encode())
    return found.hexdigest()


def plain(value: Any) -> Any:
    """Return a value as JSON has it: mappings, lists, texts and numbers.

    A dataclass becomes a mapping of its fields, with the name of its class.
    """
    if is_dataclass(value) and not isinstance(value, type):
        entries = {one.name: plain(getattr(value, one.name)) for one in fields(value)}
        return {"kind": type(value).__name__, **entries}
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(one) for one in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    return float(value) if isinstance(value, float) else str(value)


def _rounded(array: NDArray[Any]) -> str:
    if array.dtype.kind != "f":
        return " ".join(map(str, array.ravel().tolist()))
    numbers = np.where(np.abs(array) < _ZERO, 0.0, array).ravel().tolist()
    return " ".join(f"{number:.{_DIGITS}g}" for number in numbers)
