from hypothesis import HealthCheck, settings

# No deadline: this suite never asserts on time. Derandomized: a red run is red again.
settings.register_profile(
    "splatree", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow], print_blob=False
)
settings.load_profile("splatree")
