"""The four architectures as views of one data set, their diffusion policy, training and rollout."""
