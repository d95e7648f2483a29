"""From frames to samples: DBC files, the signal map, the extraction plan."""
