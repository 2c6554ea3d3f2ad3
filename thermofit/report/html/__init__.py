"""The report that people look at: one HTML file without a network, its JSON twin, and a text of methods with references."""
