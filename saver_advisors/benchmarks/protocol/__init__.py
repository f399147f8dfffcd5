"""The benchmark's protocol for algorithms that are not ours."""
