"""A first configuration for a car, proposed from its DBC and its logs."""
