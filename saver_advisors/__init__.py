"""How policies are taught and measured: advice, learner, evaluation, weights, the command line."""
