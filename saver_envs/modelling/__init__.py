"""Models of the arms (chapter 7): exact ones, a plant that differs from them, and learned ones.

The analytic half (`chain`, `dh`, `inertia`, `newton_euler`, `mico_kinematics`) is pure NumPy. The
learned half (`networks`, `models`) needs the extra ``modelling``. Nothing here knows a task or an
environment; ``saver_envs.wrappers.learned_ik`` joins the two.
"""
