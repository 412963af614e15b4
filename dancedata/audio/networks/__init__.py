"""What all features that run a network share: devices, batches, precision, the network of a process."""
