"""How far the signals of a log can be trusted (thesis section 4.2.2.2)."""
