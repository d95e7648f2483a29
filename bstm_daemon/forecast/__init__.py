"""Forecast of the brakes: ensembles of the thermal model marched ahead."""
