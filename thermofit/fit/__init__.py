"""Least squares: optimisers, scaling, covariance. Sees a residual function and nothing else."""
