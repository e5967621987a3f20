import multiarm as ma, time
s=ma.load_scene('examples/scenes/two_ur5_box.yaml') if __import__('os').path.exists('examples/scenes/two_ur5_box.yaml') else None
system=ma.compile_system(s)
ev=ma.evaluate(system); print(ev)
tr=ma.simulate(system,duration=0.2,accuracy=1e-6); print(tr.status,tr.message)
