"""Where scattered objects stand: densities, poses, distances, how deep they lie."""
