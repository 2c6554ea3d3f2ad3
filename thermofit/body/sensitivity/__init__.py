"""Direct differentiation of a march."""
