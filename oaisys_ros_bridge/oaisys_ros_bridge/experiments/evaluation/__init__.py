"""Whether an experiment's map agrees with the world: evaluation, perturbation test, certificate."""
