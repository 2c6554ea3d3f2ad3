"""The experiment: what was measured, how it is predicted, what can be asked of it; a body, coupons, or several together."""
