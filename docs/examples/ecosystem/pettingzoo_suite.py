"""PettingZoo: its own tests of the parallel API, of seeds and of the conversion to turns."""

import pettingzoo
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from pettingzoo.utils import parallel_to_aec

import saver_envs  # noqa: F401  (registers the ids)


def make():
    return pettingzoo.make("parallel", "saver_envs/DualJacoPush-v0")


parallel_api_test(make(), num_cycles=200)
parallel_seed_test(make, num_cycles=20)
api_test(parallel_to_aec(make()), num_cycles=200)
