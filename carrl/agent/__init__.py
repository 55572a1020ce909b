"""The learner's parts: network, exploration, loss and target update, thin over TorchRL."""
