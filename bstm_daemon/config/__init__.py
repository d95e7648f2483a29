"""The configuration of one vehicle: sections, rules, reading, wording."""
