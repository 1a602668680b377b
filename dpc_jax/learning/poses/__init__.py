"""Where the poses of a batch come from: a file for each of `pose.source`."""
