"""Where the poses of a batch come from: a file for each way of learning them."""
