"""Native exports of DIC systems, infrared cameras and testing machines: one module for each format, found by content (`registry`)."""
