"""What the brakes will do: ensembles of the thermal model run ahead."""
