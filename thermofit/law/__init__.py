"""The law: what a material is, one scalar function per physical statement, and how effects enter it."""

# Lanes come with the room, before any of its kernels: those that a body compiled name lanes, so that reading them from the cache would
# otherwise import the module in the midst of type inference, whose np.exp is then no longer the np.exp of its beginning.
import thermofit.core.lanes  # noqa: F401
