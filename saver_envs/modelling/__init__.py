"""Models of the arms (chapter 7): analytic ones, a simulated twin, and learned ones.

The analytic modules (`chain`, `dh`, `mujoco_chain`, `newton_euler`, `arms`) need NumPy
and MuJoCo only; the learned ones (`networks`, `models`) need the extra ``modelling``. Nothing here
depends on a task or an environment; ``saver_envs.wrappers.learned_ik`` connects the two.
"""
