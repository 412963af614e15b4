"""The common part of features that run a network: devices, batches, precision, the network of a process."""
