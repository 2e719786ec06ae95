"""Programs that watch and steer a loop that `luxloop studio` runs."""
