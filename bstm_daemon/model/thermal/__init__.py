"""Power into temperatures: the thermal network and the brake corner on it."""
