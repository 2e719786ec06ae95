"""Importing this module registers luxloop's environments with Gymnasium: `gymnasium.make("luxloop/Snowflake-v0")`."""

from luxloop.loop.environment.registered import register

IDS = register()
