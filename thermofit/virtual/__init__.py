"""The virtual laboratory: testing machine, image correlation, infrared camera; raw folders as a laboratory hands them over."""
