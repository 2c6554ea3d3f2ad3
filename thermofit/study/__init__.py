"""The study file: its sections, its loader, its template."""
