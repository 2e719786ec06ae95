"""Environments that Gymnasium knows by id once this is imported: `gymnasium.make("luxloop/Snowflake-v0")`."""

from loop.environment.registered import register

IDS = register()
