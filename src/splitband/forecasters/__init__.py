"""Define one interface for all predictors: networks, simulators, baselines, ensembles of seeds."""
