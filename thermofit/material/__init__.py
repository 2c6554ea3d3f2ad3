"""One material point: tensor algebra, the law page, the local update."""

# Lanes come with the room, before any of its kernels: those that a body compiled name lanes, so that reading them from the cache would
# otherwise import the module in the midst of type inference, whose np.exp is then no longer the np.exp of its beginning.
import thermofit.material.lanes  # noqa: F401
