"""Results for other programmes: fields for ParaView, tables, one JSON file, material cards."""
