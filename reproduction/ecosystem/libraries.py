"""The third-party libraries that are tried with our environments, and how each is installed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

#: Folder of the programs, one file per library.
EXAMPLES: Final = "docs/examples/ecosystem"
#: Arguments of RL Zoo's programs that all its rows share.
_ZOO: Final = "--algo tqc --env JacoPush-v0 -f logs"
_SETTINGS: Final = "--gym-packages saver_envs --conf-file {root}/zoo_configs/tqc.yml"


@dataclass(frozen=True)
class Library:
    """A library and the programs that use it.

    :param name: as its users write it.
    :param package: distribution whose version is reported.
    :param programs: arguments of Python, one line each; ``{root}`` is the clone.
    :param requirements: distributions to install beside ours.
    :param unresolved: distributions to install without their dependencies, because a pin of theirs
        excludes versions that we need.
    :param pin: that pin.
    :param extra: extra of ours that is installed with it; nothing but the base package where empty.
    """

    name: str
    package: str
    programs: tuple[str, ...]
    requirements: tuple[str, ...] = ()
    unresolved: tuple[str, ...] = ()
    pin: str = ""
    extra: str = "train"


def _example(file: str) -> tuple[str, ...]:
    return (f"{{root}}/{EXAMPLES}/{file}",)


LIBRARIES: Final = (
    Library("Gymnasium", "gymnasium", _example("gymnasium_wrappers.py")),
    Library("Gymnasium-Robotics", "gymnasium-robotics", _example("gymnasium_robotics_goals.py")),
    Library("PettingZoo", "pettingzoo", _example("pettingzoo_suite.py")),
    Library("sb3-contrib", "sb3-contrib", _example("sb3_contrib_tqc.py")),
    Library(
        "RL Zoo",
        "rl_zoo3",
        (
            f"-m rl_zoo3.train {_ZOO} {_SETTINGS} -n 400 --eval-freq -1",
            f"-m rl_zoo3.enjoy {_ZOO} --gym-packages saver_envs -n 60 --no-render",
            f"-m rl_zoo3.train {_ZOO} {_SETTINGS} -optimize --n-trials 2 -n 400 --n-evaluations 1",
            "-m rl_zoo3.plots.plot_train -a tqc -e JacoPush-v0 -f logs",
        ),
    ),
    Library("SuperSuit", "supersuit", _example("supersuit_ppo.py"), ("supersuit",)),
    Library("SBX", "sbx-rl", _example("sbx_tqc.py"), ("sbx-rl",)),
    Library("TorchRL", "torchrl", _example("torchrl_rollout.py"), ("torchrl",)),
    Library("skrl", "skrl", _example("skrl_ddpg.py"), ("skrl",)),
    Library("Tianshou", "tianshou", _example("tianshou_td3.py"), ("tianshou>=2",)),
    Library("Minari", "minari", _example("minari_dataset.py"), ("minari",)),
    Library("CleanRL (style)", "torch", _example("cleanrl_ddpg.py")),
    Library(
        "d3rlpy",
        "d3rlpy",
        _example("d3rlpy_offline.py"),
        ("structlog", "dataclasses-json", "typing-extensions", "colorama", "click", "h5py", "tqdm"),
        ("d3rlpy",),
        "gymnasium==1.0.0",
    ),
    Library(
        "RLlib",
        "ray",
        _example("rllib_sac.py"),
        ("ray", "dm_tree", "pandas", "pyarrow", "tensorboardX", "pydantic<3", "lz4", "scipy"),
        (),
        "ray[rllib] has gymnasium==1.2.2; its requirements are installed by name",
    ),
    Library(
        "Safety-Gymnasium",
        "safety-gymnasium",
        _example("safety_gymnasium_step.py"),
        ("xmltodict", "pygame"),
        ("safety-gymnasium",),
        "gymnasium==0.28.1, mujoco==2.3.3",
    ),
    Library(
        "OmniSafe",
        "omnisafe",
        _example("omnisafe_cpo.py"),
        ("wandb", "gdown", "moviepy", "tensorboard", "typer", "xmltodict", "pygame", "seaborn"),
        ("omnisafe", "safety-gymnasium"),
        "safety-gymnasium, which has gymnasium==0.28.1",
    ),
    Library(
        "LeRobot",
        "lerobot",
        _example("lerobot_dataset.py"),
        ("lerobot",),
        (),
        "torch<2.11: installs with the base package, without `train`",
        "",
    ),
)
