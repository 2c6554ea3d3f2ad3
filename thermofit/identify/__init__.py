"""Where instruments, kernel and optimiser meet: forward models of the stages, their residuals, and what a stage reports."""
