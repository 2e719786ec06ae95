"""Studies: campaigns, tuning, evaluation of pixel controllers, data sets, detector training, learning environments, contracts."""
