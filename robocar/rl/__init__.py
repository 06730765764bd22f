"""The simulation as a learning environment (extra `rl`): `robocar.rl.dm.RobocarEnv` and `robocar.rl.gym.RobocarGymEnv`.

`import robocar.rl.gym` registers one id per scenario, `robocar/<scenario>-v0`.
"""
