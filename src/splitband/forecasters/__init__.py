"""Put whatever predicts behind one interface: networks, simulators, baselines, means of seeds."""
