"""What a drive shows about the car: resistances, friction, stops."""
