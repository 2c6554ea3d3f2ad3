"""One material point: tensor algebra, the law page, the local update."""
