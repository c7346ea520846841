"""What shapes a ground: water, slopes, rock, ice, wind, lava and impacts, each as a process."""
