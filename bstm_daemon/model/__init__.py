"""The physics, pure: heat, temperatures, effects, wear and risk."""
