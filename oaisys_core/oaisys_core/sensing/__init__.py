"""From a backend's images to a sample: the view cache, lens effects and sensor faults."""
