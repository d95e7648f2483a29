"""What a drive tells of the car: resistances, friction, stops."""
