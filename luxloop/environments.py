"""Importing this module registers luxloop's environments with Gymnasium: `gymnasium.make("luxloop/Snowflake-v0")`."""

from luxloop.loop.studies.environment.make import register

IDS = register()
