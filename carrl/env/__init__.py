"""The driving task: the only place where physics meets TensorDict."""
