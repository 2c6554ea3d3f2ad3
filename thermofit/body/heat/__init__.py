"""The heat equation on the deformed body: conduction, films, sources, coupling to the mechanics."""
