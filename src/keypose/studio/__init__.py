"""The browser studio: a local server, typed messages, and the built client in ``static``."""

from keypose.studio.server import StudioServer, serve

__all__ = ["StudioServer", "serve"]
