"""Human pose estimation: skeleton, fields, network, parsing, data and training."""
