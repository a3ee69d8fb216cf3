"""Sentences of authors who do not know the language: with their expected readings, or to be refused."""

READ = {
    "First Agent_2 lifts the lid, then Agent_1 begins": "Agent_2 must lift lid before Agent_1 begins.",
    "First Agent_2 lifts the lid, then Agent_1 starts its task": (
        "Agent_2 must lift lid before Agent_1 begins."
    ),
    "Agent_1 waits until Agent_2 ends": "Agent_2 must complete its task before Agent_1 begins.",
    "Agent_1 waits until Agent_2 is done": "Agent_2 must complete its task before Agent_1 begins.",
    "Agent_1 waits until Agent_2 finishes lifting the lid": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 waits until Agent_2 lifts the lid": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 must not begin until Agent_2 lifts the lid": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 must not act before Agent_2 has finished": (
        "Agent_2 must complete its task before Agent_1 begins."
    ),
    "Agent_1 never moves before Agent_2 has finished": (
        "Agent_2 must complete its task before Agent_1 begins."
    ),
    "Agent_1 may place the steak only after Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 may only place the steak after Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 must only place the steak after Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Once the lid is on the table, Agent_1 must place the steak": (
        "Agent_1 must place steak only after lid is on the table."
    ),
    "Agent_1 places the steak once the lid is on the table": (
        "Agent_1 must place steak only after lid is on the table."
    ),
    "Agent_1 and Agent_2 must lift the barrier simultaneously within 5 s of each other": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 5 s of each other."
    ),
    "Agent_1 and Agent_2 must lift the barrier at the same time at most 3 s apart": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 3 s of each other."
    ),
    "Agent_1 and Agent_2 must both lift the barrier together": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 0.1 s."
    ),
    "Agent_1 must grasp the steak from above": (
        "The gripper of Agent_1 must be vertical at steak when grasping it."
    ),
    "Agent_1 must grasp the steak vertically": (
        "The gripper of Agent_1 must be vertical at steak when grasping it."
    ),
    "Agent_1 must press the lid from the side": (
        "The gripper of Agent_1 must be horizontal at lid when pressing it."
    ),
    "Agent_2 must open the lid before Agent_1 begins": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 must move at most at 20 centimeters/s": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must keep its gripper below 20 centimeters": "Agent_1 must keep its gripper below 0.2 m.",
    "Agent_1 must keep its gripper below 20 millimeters": "Agent_1 must keep its gripper below 0.02 m.",
    "Agent_1 must keep its gripper below 20 millimetres": "Agent_1 must keep its gripper below 0.02 m.",
    "Agent_1 must keep its gripper below 20 centimetre": "Agent_1 must keep its gripper below 0.2 m.",
    "Agent_1 must move at most at 0.2 meters per second": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must move at most at 0.2 metres/second": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must not move faster than 200 mm per second": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must finish within 10 secs": "Agent_1 must finish within 10 s.",
    "Agent_1 must finish within 1 minute": "Agent_1 must finish within 60 s.",
    "Agent_1 must finish within 500 ms": "Agent_1 must finish within 0.5 s.",
    "Agent_1 must finish within 500 milliseconds": "Agent_1 must finish within 0.5 s.",
    "Agent_2 must keep the lid level within 5 °": "Agent_2 must keep lid level within 5 deg.",
    "Agent_2 must keep the lid level within 0.1 rad": (
        "Agent_2 must keep lid level within 5.729577951308232 deg."
    ),
    "Agent_2 must keep the lid level within 0.1 radians": (
        "Agent_2 must keep lid level within 5.729577951308232 deg."
    ),
    "Agent_1 must move at most with 0.2 m/s": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 waits 2 s after Agent_2": "Agent_1 must wait 2 s after Agent_2 has finished.",
    "Agent_1 must place the steak after Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 must place the steak once Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 will finish within 3 s": "Agent_1 must finish within 3 s.",
    "Agent_1 has to finish before Agent_2 has to lift the lid": (
        "Agent_1 must complete its task before Agent_2 may lift lid."
    ),
    "Agent_1 must be done within 3 s": "Agent_1 must finish within 3 s.",
    "Agent_1 completes within 3 s": "Agent_1 must finish within 3 s.",
    "Agent_1 must end within 3 s": "Agent_1 must finish within 3 s.",
    "The lid is lifted by Agent_2 before Agent_1 places the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "The steak must be on the pot before Agent_2 begins": "Agent_2 must wait until steak is on pot.",
    "Before Agent_1 begins, Agent_2 must finish": "Agent_2 must complete its task before Agent_1 begins.",
    "Agent_1 must keep the lid level": "Agent_1 must keep lid level within 10 deg.",
    "Agent_1 must keep the lid horizontal": "Agent_1 must keep lid level within 10 deg.",
    "Agent_1 must keep the lid upright": "Agent_1 must keep lid level within 10 deg.",
    "The gripper of Agent_1 must be vertical to lid": "The gripper of Agent_1 must be vertical at lid.",
    "The gripper of Agent_1 must be vertical at lid": "The gripper of Agent_1 must be vertical at lid.",
    "The gripper of Agent_1 must be horizontal to the lid when lifting it": (
        "The gripper of Agent_1 must be horizontal at lid when lifting it."
    ),
    "The gripper of Agent_1 must be level to lid": "The gripper of Agent_1 must be level at lid.",
    "The gripper of Agent_1 must be perpendicular at lid": (
        "The gripper of Agent_1 must be perpendicular to lid."
    ),
    "Agent_1 must put down the steak within 5 s": "Agent_1 must place steak within 5 s.",
    "Agent_1 must move the lid within 5 s": "Agent_1 must carry lid within 5 s.",
    "Agent_1 must set the steak within 5 s": "Agent_1 must place steak within 5 s.",
    "Agent_1 must insert the steak within 5 s": "Agent_1 must place steak within 5 s.",
    "Agent_1 must stack the steak within 5 s": "Agent_1 must place steak within 5 s.",
    "Agent_1 must drop the steak within 5 s": "Agent_1 must release steak within 5 s.",
    "Agent_1 must hit the lid within 5 s": "Agent_1 must strike lid within 5 s.",
    "Agent_1 must bring the lid within 5 s": "Agent_1 must carry lid within 5 s.",
    "Agent_1 must hold the lid within 5 s": "Agent_1 must hold lid within 5 s.",
    "Agent_1 must hold the lid before Agent_2 places the steak": (
        "Agent_1 must hold lid before Agent_2 may place steak."
    ),
    "Agent_1 may place the steak only once Agent_2 has lifted the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 can place the steak only after Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 should place the steak only after Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 must wait for 5 s after Agent_2": "Agent_1 must wait 5 s after Agent_2 has finished.",
    "Agent_1 must wait for at least 5 s after Agent_2 has finished": (
        "Agent_1 must wait 5 s after Agent_2 has finished."
    ),
    "Agent_1 waits 5 s after Agent_2 has released the lid": (
        "Agent_1 must wait 5 s after Agent_2 releases lid."
    ),
    "Agent_1 must not lift the steak until Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may lift steak."
    ),
    "Agent_1 must not hold the steak until Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may hold steak."
    ),
    "Agent_1 must not drop the steak until Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may release steak."
    ),
    "Agent_1 must not move the steak before Agent_2 lifts the lid": (
        "Agent_2 must lift lid before Agent_1 may carry steak."
    ),
    "Agent_2 must move the lid before Agent_1 moves": "Agent_2 must carry lid before Agent_1 begins.",
    "Agent_2 must lift the lid before Agent_1 acts": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_2 must lift the lid before Agent_1 proceeds": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_2 must lift the lid before Agent_1 proceeds with its task": (
        "Agent_2 must lift lid before Agent_1 begins."
    ),
    "Agent_2 lifts the lid before Agent_1 is to place the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_2 lifts the lid before Agent_1 is allowed to place the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_2 has lifted the lid before Agent_1 starts": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_2 must have lifted the lid before Agent_1 starts": "Agent_2 must lift lid before Agent_1 begins.",
    "First the lid is lifted by Agent_2, then the steak is placed by Agent_1": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "First the lid must be on the table, then Agent_1 places the steak": (
        "Agent_1 must place steak only after lid is on the table."
    ),
    "Agent_1 places the steak then Agent_2 lifts the lid": (
        "Agent_1 must place steak before Agent_2 may lift lid."
    ),
    "Agent_1 must wait for Agent_2 to be done with its task": (
        "Agent_2 must complete its task before Agent_1 begins."
    ),
    "Agent_1 waits for Agent_2 to complete the task": "Agent_2 must complete its task before Agent_1 begins.",
    "Agent_1 must wait until the lid is lifted by Agent_2": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 must wait until the lid was lifted by Agent_2": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 must wait until the lid is on the pot": "Agent_1 must wait until lid is on pot.",
    "Agent_1 must wait until the lid is back on the table": "Agent_1 must wait until lid is on the table.",
    "Agent_1 must wait until the lid lies on the steak": "Agent_1 must wait until lid is on steak.",
    "Agent_1 must wait until the lid has been put on the table": (
        "Agent_1 must wait until lid is on the table."
    ),
    "Agent_1 must wait until the lid has been put back on the table": (
        "Agent_1 must wait until lid is on the table."
    ),
    "Agent_1 and Agent_2 must start their tasks together": (
        "Agent_1 and Agent_2 must perform their tasks simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 begin their motions in sync": (
        "Agent_1 and Agent_2 must perform their tasks simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 perform tasks together": (
        "Agent_1 and Agent_2 must perform their tasks simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 perform the task together": (
        "Agent_1 and Agent_2 must perform their tasks simultaneously within 0.1 s."
    ),
    "Agents 1 and 2 must both grasp the steak concurrently": (
        "Agent_1 and Agent_2 must grasp steak simultaneously within 0.1 s."
    ),
    "Agent_1, Agent_2 must grasp the steak together": (
        "Agent_1 and Agent_2 must grasp steak simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 must grasp the steak together, within 0.2 s of each other": (
        "Agent_1 and Agent_2 must grasp steak simultaneously within 0.2 s."
    ),
    "Agent_1 and Agent_2 must grasp the steak together to within 0.2 s": (
        "Agent_1 and Agent_2 must grasp steak simultaneously within 0.2 s."
    ),
    "Agent_1 and Agent_2 must grasp the steak together, at most 0.2 s apart": (
        "Agent_1 and Agent_2 must grasp steak simultaneously within 0.2 s."
    ),
    "Agent_1 must keep at least 10 cm from Agent_2": (
        "Agent_1 and Agent_2 must keep their arms at least 0.1 m apart."
    ),
    "Agent_1 keeps a distance of at least 10 cm from Agent_2": (
        "Agent_1 and Agent_2 must keep their arms at least 0.1 m apart."
    ),
    "Agent_1 must keep its gripper above 10 cm above the table": "Agent_1 must keep its gripper above 0.1 m.",
    "Agent_1 must keep its gripper under 10 cm": "Agent_1 must keep its gripper below 0.1 m.",
    "The gripper of Agent_1 must be above 10 cm": "Agent_1 must keep its gripper above 0.1 m.",
    "The gripper of Agent_1 must never be faster than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "The gripper of Agent_1 must not move faster than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "Agent_1 must move slower than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "Agent_1 must keep the lid level to within 5 deg": "Agent_1 must keep lid level within 5 deg.",
    "The lid should be level": "lid must stay level within 10 deg.",
    "The lid must be horizontal": "lid must stay level within 10 deg.",
    "Keep the lid horizontal": "lid must stay level within 10 deg.",
    "Agent_1 must carry the steak upright": "Agent_1 must keep steak level within 10 deg.",
    "Agent_1 must not hit Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Avoid all collisions between Agent_1 and the environment": (
        "Avoid collision between Agent_1 and the objects."
    ),
    "Agent_1 must not touch the other arm": "Avoid collision between Agent_1 and other agents.",
    "Agent_1 must not touch all other arms": "Avoid collision between Agent_1 and other agents.",
    "Agent_1 must not touch any objects": "Avoid collision between Agent_1 and the objects.",
    "Agent_1 must not touch all objects": "Avoid collision between Agent_1 and the objects.",
    "Agent_1 must not interfere with Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_1 must not intersect the paths of other agents": (
        "Avoid collision between Agent_1 and other agents."
    ),
    "Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) before Agent_2 lifts the lid": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until Agent_2 lifts lid."
    ),
    "Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) when Agent_2 is inside": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while Agent_2 is in it."
    ),
    "Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) while the lid is still there": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while lid is in it."
    ),
    "Agent_1 and Agent_2 may use the space in turn": (
        "Agent_1 and Agent_2 may share the same space one after the other."
    ),
    "Agent_1 and Agent_2 can use the same area at different times": (
        "Agent_1 and Agent_2 may share the same space one after the other."
    ),
    "Agent_1 and Agent_2 must keep the same height": (
        "Agent_1 and Agent_2 must keep a consistent gripper height."
    ),
    "Agent_1 and Agent_2 must keep the same gripper height when carrying the steak": (
        "Agent_1 and Agent_2 must keep a consistent gripper height when carrying steak."
    ),
    "Agent_1 and Agent_2 have the same height": "Agent_1 and Agent_2 must keep a consistent gripper height.",
    "Agent_1 and Agent_2 must hold the same height": (
        "Agent_1 and Agent_2 must keep a consistent gripper height."
    ),
    "Keep the gripper heights the same": "Agent_1 and Agent_2 must keep a consistent gripper height.",
    "Keep gripper height the same of Agent_1 and Agent_2 while lifting the lid": (
        "Agent_1 and Agent_2 must keep a consistent gripper height when lifting lid."
    ),
    "Agent_1 must grasp the lid by its knob": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must grasp the lid on the knob handle": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must take the lid by the knob": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 picks the steak at its center": "Agent_1 must grasp steak at its center point.",
    "Agent_1 must grasp the knob end of the lid": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must place the steak on the inside of the pot": (
        "Agent_1 must place steak at the inside point of pot."
    ),
    "Agent_1 must put the steak in the inside of the pot": (
        "Agent_1 must place steak at the inside point of pot."
    ),
    "Agent_1 must stack the steak on the inside of the pot": (
        "Agent_1 must place steak at the inside point of pot."
    ),
    "Agent_1 must set down the steak at the inside part of the pot": (
        "Agent_1 must place steak at the inside point of pot."
    ),
    "Agent_1 must reach the lid from above": "The gripper of Agent_1 must be vertical at lid.",
    "Agent_1 should approach the lid from the side": "The gripper of Agent_1 must be horizontal at lid.",
    "Agent_1 must push the lid from above": (
        "The gripper of Agent_1 must be vertical at lid when pressing it."
    ),
    "Agent_1 must grasp the lid horizontally": (
        "The gripper of Agent_1 must be horizontal at lid when grasping it."
    ),
    "The gripper of Agent_1 stays level while placing the steak": (
        "The gripper of Agent_1 must be level at steak when placing it."
    ),
    "Agent_1 holds its gripper horizontal while placing the steak": (
        "The gripper of Agent_1 must be horizontal at steak when placing it."
    ),
    "Agent_1 finishes within 10 s": "Agent_1 must finish within 10 s.",
    "Agent_1 must end its motion within 10 s": "Agent_1 must finish within 10 s.",
    "Agent_1 must complete the task within 10 s": "Agent_1 must finish within 10 s.",
    "Agent_1 must release the lid within 10 s": "Agent_1 must release lid within 10 s.",
    "Agent_1 lets go of the lid within 10 s": "Agent_1 must release lid within 10 s.",
    "The right arm must finish before the left arm begins": (
        "Agent_2 must complete its task before Agent_1 begins."
    ),
    "The leftmost arm must finish before the right-hand robot begins": (
        "Agent_1 must complete its task before Agent_2 begins."
    ),
    "Robot 1 must finish before robots 2 begins": "Agent_1 must complete its task before Agent_2 begins.",
    "Arm 1 and 2 must not collide": "Avoid collision between Agent_1 and Agent_2.",
    "Agents 1, 2 must not collide": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_2 must finish lifting the lid before Agent_1 begins": (
        "Agent_2 must lift lid before Agent_1 begins."
    ),
    "Agent_2 has finished lifting the lid before Agent_1 starts placing the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 waits until Agent_2 has finished lifting the lid": (
        "Agent_2 must lift lid before Agent_1 begins."
    ),
    "Agent_1 waits until Agent_2 is done lifting the lid before placing the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_1 waits for Agent_2 to finish lifting the lid": "Agent_2 must lift lid before Agent_1 begins.",
    "Agent_1 must finish placing the steak within 10 s": "Agent_1 must place steak within 10 s.",
    "Agent_1 must end placing the steak within 10 s": "Agent_1 must place steak within 10 s.",
    "First Agent_2 lifts the lid, then Agent_1 may place the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "First Agent_2 finishes, then Agent_1 starts to place the steak": (
        "Agent_2 must complete its task before Agent_1 may place steak."
    ),
    "Agent_1 waits 500 ms after Agent_2 lifts the lid": "Agent_1 must wait 0.5 s after Agent_2 lifts lid.",
    "Agent_1 waits 1 minute after Agent_2 lifts the lid": "Agent_1 must wait 60 s after Agent_2 lifts lid.",
    "Agent_1 must finish within 2 mins": "Agent_1 must finish within 120 s.",
    "Agent_1 must keep its gripper below 1 meter": "Agent_1 must keep its gripper below 1 m.",
    "Agent_1 must keep its gripper below 1 metre over the table": "Agent_1 must keep its gripper below 1 m.",
    "Agent_1 must keep its gripper below 200 millimeters above the table": (
        "Agent_1 must keep its gripper below 0.2 m."
    ),
    "Agent_1 must move slower than 20 centimetres/s": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must move slower than 20 cm / s": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must move slower than 20 cm per second": "Agent_1 must move at most at 0.2 m/s.",
    "Agents 1 and 2 must keep their grippers at least 10 centimeters apart": (
        "Agent_1 and Agent_2 must keep their grippers at least 0.1 m apart."
    ),
    "Agent_1 and Agent_2 must lift the barrier simultaneously within 2 s": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 2 s."
    ),
    "Agent_1 and Agent_2 must lift the barrier simultaneously within 100 ms": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 must lift the barrier together within 1 s of each other": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 1 s."
    ),
    "Agent_1 and Agent_2 must lift the barrier together within 10 s of each other": (
        "Agent_1 and Agent_2 must lift barrier simultaneously within 10 s of each other."
    ),
    "Agent_1 grasps the steak from above": (
        "The gripper of Agent_1 must be vertical at steak when grasping it."
    ),
    "Agent_1 approaches the steak from the side": "The gripper of Agent_1 must be horizontal at steak.",
    "Agent_1 picks up the steak from above": (
        "The gripper of Agent_1 must be vertical at steak when grasping it."
    ),
    "The lid must be opened by Agent_2 before Agent_1 places the steak": (
        "Agent_2 must lift lid before Agent_1 may place steak."
    ),
    "Agent_2 must lift the lid before Agent_1 places the lid": (
        "Agent_2 must lift lid before Agent_1 may place lid."
    ),
    "Agent_2 must never lift the lid until Agent_1 is done": (
        "Agent_1 must complete its task before Agent_2 may lift lid."
    ),
    "Agent_2 may not lift the lid until Agent_1 is done": (
        "Agent_1 must complete its task before Agent_2 may lift lid."
    ),
    "Agent_2 cannot begin until Agent_1 is done": "Agent_1 must complete its task before Agent_2 begins.",
    "Only once Agent_1 is done, Agent_2 must lift the lid": (
        "Agent_1 must complete its task before Agent_2 may lift lid."
    ),
    "Once Agent_1 is done Agent_2 will lift the lid": (
        "Agent_1 must complete its task before Agent_2 may lift lid."
    ),
    "Agent_2 must not release the lid until Agent_1 has placed the steak": (
        "Agent_1 must place steak before Agent_2 may release lid."
    ),
    "Agent_2 must not let go of the lid before Agent_1 has placed the steak": (
        "Agent_1 must place steak before Agent_2 may release lid."
    ),
    "Agent_2 must not put down the lid before the steak is on the pot": (
        "Agent_2 must place lid only after steak is on pot."
    ),
    "The lid must be on the table before Agent_1 begins": "Agent_1 must wait until lid is on the table.",
    "The lid must be back on the pot before Agent_1 begins": "Agent_1 must wait until lid is on pot.",
    "Agent_1 and Agent_2 must release the barrier together": (
        "Agent_1 and Agent_2 must release barrier simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 must place the barrier together, at most 2 s apart": (
        "Agent_1 and Agent_2 must place barrier simultaneously within 2 s."
    ),
    "Agent_1 and Agent_2 must hold the barrier together": (
        "Agent_1 and Agent_2 must hold barrier simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 must press the barrier together": (
        "Agent_1 and Agent_2 must press barrier simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 must hammer the barrier together": (
        "Agent_1 and Agent_2 must strike barrier simultaneously within 0.1 s."
    ),
    "Agent_1 and Agent_2 must start their motions at the same time within 0.5 s of each other": (
        "Agent_1 and Agent_2 must perform their tasks simultaneously within 0.5 s."
    ),
    "Agent_1 and Agent_2 may share the shared space in turn": (
        "Agent_1 and Agent_2 may share the same space one after the other."
    ),
    "Agent_1 and Agent_2 may share the same space sequentially": (
        "Agent_1 and Agent_2 may share the same space one after the other."
    ),
    "Agent_1 must not enter the space of Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_1 must avoid collisions with Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_1 must not collide with any other agents": "Avoid collision between Agent_1 and other agents.",
    "Agent_1 can not touch Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_1 should not hit the objects": "Avoid collision between Agent_1 and the objects.",
    "Agent_1 must not intersect Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_1 must not intersect with the path of Agent_2": "Avoid collision between Agent_1 and Agent_2.",
    "Avoid collision of Agent_1 with other agents": "Avoid collision between Agent_1 and other agents.",
    "Avoid any collision between Agent_1 and any other arm": (
        "Avoid collision between Agent_1 and other agents."
    ),
    "All agents must avoid collisions with each other": "Avoid collision between Agent_1 and Agent_2.",
    "All arms must not collide": "Avoid collision between Agent_1 and Agent_2.",
    "Agent_1 and Agent_2 must hold the arms at least 10 cm apart": (
        "Agent_1 and Agent_2 must keep their arms at least 0.1 m apart."
    ),
    "Agent_1 and Agent_2 have their hands at least 10 cm apart": (
        "Agent_1 and Agent_2 must keep their grippers at least 0.1 m apart."
    ),
    "The grippers of Agent_1 and Agent_2 are at least 10 cm apart": (
        "Agent_1 and Agent_2 must keep their grippers at least 0.1 m apart."
    ),
    "Agent_1 must remain at least 10 cm from Agent_2": (
        "Agent_1 and Agent_2 must keep their arms at least 0.1 m apart."
    ),
    "Agent_1 should stay a distance of at least 10 cm from Agent_2": (
        "Agent_1 and Agent_2 must keep their arms at least 0.1 m apart."
    ),
    "Agent_1 must hold the hand over 10 cm": "Agent_1 must keep its gripper above 0.1 m.",
    "The hand of Agent_1 must be kept under 10 cm above the table": (
        "Agent_1 must keep its gripper below 0.1 m."
    ),
    "The gripper of Agent_1 should remain over 10 cm": "Agent_1 must keep its gripper above 0.1 m.",
    "Agent_1 must move at no more than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "Agent_1 may not move faster than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "Agent_1 can not move faster than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "Agent_1 cannot move its gripper faster than 10 cm/s": "Agent_1 must move at most at 0.1 m/s.",
    "Agent_1 must keep the lid horizontal, within 10 deg": "Agent_1 must keep lid level within 10 deg.",
    "Agent_1 must keep the lid upright to within 10 degrees": "Agent_1 must keep lid level within 10 deg.",
    "Agent_1 will keep the lid level": "Agent_1 must keep lid level within 10 deg.",
    "The lid must remain upright": "lid must stay level within 10 deg.",
    "The gripper of Agent_1 stays perpendicular while grasping the lid": (
        "The gripper of Agent_1 must be perpendicular to lid when grasping it."
    ),
    "The hand of Agent_1 should be level to the lid while holding it": (
        "The gripper of Agent_1 must be level at lid when holding it."
    ),
    "Agent_1 must keep its gripper level when opening the lid": (
        "The gripper of Agent_1 must be level at lid when lifting it."
    ),
    "Agent_1 must hold the gripper vertical while moving the lid": (
        "The gripper of Agent_1 must be vertical at lid when carrying it."
    ),
    "Agent_1 must reach the lid perpendicularly": "The gripper of Agent_1 must be perpendicular to lid.",
    "Agent_1 must grip the lid vertically": (
        "The gripper of Agent_1 must be vertical at lid when grasping it."
    ),
    "Agent_1 must seize the lid perpendicularly": (
        "The gripper of Agent_1 must be perpendicular to lid when grasping it."
    ),
    "Agent_1 grabs the lid from the side": (
        "The gripper of Agent_1 must be horizontal at lid when grasping it."
    ),
    "Agent_1 grasps the knob of the lid": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must take the knob of the lid": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must pick up the lid by the knob handle": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must pick the lid by its knob": "Agent_1 must grasp lid at its knob point.",
    "Agent_1 must place the steak at the inside of the pot": (
        "Agent_1 must place steak at the inside point of pot."
    ),
    "Agent_1 must insert the steak into the inside of the pot": (
        "Agent_1 must place steak at the inside point of pot."
    ),
    "Agent_1 and Agent_2 maintain equal gripper heights while carrying the lid": (
        "Agent_1 and Agent_2 must keep a consistent gripper height when carrying lid."
    ),
    "Keep the gripper height consistent for Agent_1 and Agent_2 when placing the lid": (
        "Agent_1 and Agent_2 must keep a consistent gripper height when placing lid."
    ),
    "Keep the lid level": "lid must stay level within 10 deg.",
    "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until Agent_2 is done lifting the lid": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until Agent_2 lifts lid."
    ),
    "Agent_1 can not enter zone (0, 0, 0) to (1, 1, 1) while the lid is inside": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while lid is in it."
    ),
    "Agent_1 never enters the box (0, 0, 0) to (1, 1, 1) when Agent_2 is still there": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while Agent_2 is in it."
    ),
    "Agent_1 avoids the box (0, 0, 0) to (1, 1, 1) until the lid is back on the pot": (
        "Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until lid is on pot."
    ),
    "Agent_1 must not proceed with its work until Agent_2 has ended its motion": (
        "Agent_2 must complete its task before Agent_1 begins."
    ),
    "Agents 1 and 2 must keep their arms at least 50 millimeters apart": (
        "Agent_1 and Agent_2 must keep their arms at least 0.05 m apart."
    ),
    "The gripper of Agent_2 must stay above 2 centimeters": "Agent_2 must keep its gripper above 0.02 m.",
    "Agent_1 must not move faster than 20 centimeters per second": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must not move faster than 200 millimeters/s": "Agent_1 must move at most at 0.2 m/s.",
    "Agent_1 must keep its gripper below .4 Meters": "Agent_1 must keep its gripper below 0.4 m.",
    "Agent_1 must keep its gripper below 40centimetres": "Agent_1 must keep its gripper below 0.4 m.",
    "Agent_1 must keep its gripper below 4e2 mm": "Agent_1 must keep its gripper below 0.4 m.",
}

REFUSED = """
First Agent_2 lifts the lid, then Agent_1 finishes
First Agent_2 lifts the lid, then Agent_1 must finish
First Agent_2 lifts the lid, then Agent_1 ends
Agent_2 must lift the lid before Agent_1 finishes
Agent_2 must lift the lid before Agent_1 ends
Agent_2 must begin before Agent_1 finishes
Agent_2 must begin before Agent_1 begins
Agent_2 begins, then Agent_1 begins
Agent_2 must start before Agent_1 starts
Agent_2 must finish before Agent_1 finishes
Agent_1 must wait until Agent_2 begins
Agent_1 must wait until Agent_2 starts
Agent_1 must wait until Agent_2 stops
Agent_1 must wait until Agent_2 has stopped
Agent_1 waits until Agent_2 is lifting the lid
Agent_1 must not finish until Agent_2 lifts the lid
Agent_1 must not move until Agent_2 stops
Agent_1 must place the steak only after Agent_2 begins
Agent_1 must place only the steak after Agent_2 lifts the lid
Agent_1 must lift the lid while Agent_2 lifts the steak
Agent_1 and Agent_2 must lift the barrier together within 10 s
Agent_1 and Agent_2 must lift the barrier together within 600 s
Agent_1 and Agent_2 must lift the barrier simultaneously within 5 s
Agent_1 must lift the lid vertically
Agent_1 must carry the lid horizontally
Agent_1 must keep the steak vertically
Agent_1 must hold the lid horizontally
Agent_1 must place the steak vertically
Agent_1 must place the steak from above
Agent_1 must lift the lid from above
Agent_1 must lift the lid perpendicularly
Agent_1 must release the steak from above
Agent_1 must drop the steak from above
Agent_1 must move the lid horizontally
Agent_1 must push the lid horizontally
Agent_1 must strike the lid from above
Agent_1 must remove the lid within 10 s
Agent_2 must remove the lid before Agent_1 begins
Agent_1 must keep its gripper below 5 inches
Agent_1 must finish in 10 s
Agent_1 must finish no later than 10 s
Agent_1 must finish after 10 s
Agent_1 must finish within 10 s after Agent_2 lifts the lid
Agent_1 must lift the steak 2 s after Agent_2 lifts the lid
Agent_1 must lift the steak for 2 s after Agent_2 lifts the lid
Agent_1 lifts the steak for at least 2 s after Agent_2 lifts the lid
Agent_1 waits for 2 s after Agent_2 begins
Agent_1 waits at least 2 s after Agent_2 stops
Agent_1 takes the steak after Agent_2 lifts the lid
The steak is on the pot before Agent_2 begins
Before Agent_1 finishes, Agent_2 must lift the lid
After Agent_2 begins, Agent_1 must place the steak
Agent_1 must keep the lid vertical
Agent_1 must hold the steak vertical
Agent_1 must keep its gripper vertical
Agent_1 must put the steak down within 5 s
Agent_1 must open the pot within 5 s
Agent_1 must pick the steak up within 5 s
Agent_1 must take the lid within 5 s
Agent_1 must keep the lid within 5 s
Agent_1 must keep the lid until Agent_2 places the steak
Agent_1 must push the steak within 5 s
As soon as Agent_2 lifts the lid, Agent_1 must place the steak
Agent_1 must place the steak as soon as Agent_2 lifts the lid
Agent_1 must place the steak no later than 5 s after Agent_2 lifts the lid
Agent_1 must place the steak at most 5 s after Agent_2 lifts the lid
Agent_1 must place the steak less than 5 s after Agent_2 lifts the lid
Agent_1 must wait at most 5 s after Agent_2 lifts the lid
Agent_1 must wait no more than 5 s after Agent_2 lifts the lid
Agent_1 must not wait 5 s after Agent_2 lifts the lid
Agent_1 never waits until Agent_2 lifts the lid
Agent_1 must lift the steak until Agent_2 lifts the lid
Agent_1 must hold the steak until Agent_2 lifts the lid
Agent_1 must keep the steak until Agent_2 lifts the lid
Agent_1 must not release the steak before Agent_2 has opened the pot
Agent_1 must not move before Agent_2
Agent_2 must move before Agent_1 moves
Agent_2 must act before Agent_1 acts
Agent_2 lifts the lid before Agent_1 is not allowed to place the steak
Agent_2 lifted the lid before Agent_1 placed the steak
Agent_2 must lift the lid before Agent_1 has placed the steak
Agent_2 must lift the lid before the steak is placed by Agent_1
The lid must be lifted by Agent_2 before the steak is placed by Agent_1
First Agent_1 places the steak, then the lid must be on the table
Agent_2 lifts the lid, then Agent_1 places the steak, then Agent_2 finishes
Then Agent_1 places the steak
Agent_1 must place the steak before Agent_2 lifts the lid and Agent_1 must finish within 10 s
Agent_1 must place the steak before lifting the lid
Agent_1 must place the steak before Agent_1 lifts the steak
Agent_1 must wait for Agent_2
Agent_1 waits for Agent_2 to stop
Agent_1 waits for Agent_2 to begin
Agent_1 waits for Agent_2 to place the lid on the table
Agent_1 must wait until the lid is not on the pot
Agent_1 must wait until the lid is in the pot
Agent_1 and Agent_2 must finish together
Agent_1 and Agent_2 must finish their tasks simultaneously
Agent_1 and Agent_2 must start together
Agent_1 and Agent_2 must begin their tasks within 2 s of each other
Agent_1 and Agent_2 do their work together
Agent_1 or Agent_2 must grasp the steak together
Either Agent_1 or Agent_2 must finish within 10 s
Agent_1 and Agent_2 must finish within 10 s
Agent_1 and Agent_2 respectively must lift lid and steak together
Agent_1 and Agent_2 must not lift the steak together
Agent_1 and Agent_2 must not perform tasks at the same time
Agent_1 and Agent_2 may lift the steak together
Agent_1 and Agent_2 must grasp the steak at least 2 s apart
Agent_1 and Agent_2 must grasp the steak together at least 2 s apart
Agent_1 and Agent_2 must keep their grippers at most 10 cm apart
Agent_1 and Agent_2 must keep their grippers 10 cm apart
Agent_1 and Agent_2 must not keep their grippers at least 10 cm apart
Agent_1 must stay at most 10 cm away from Agent_2
Agent_1 must not stay at least 10 cm away from Agent_2
Agent_1 must stay at least 10 cm away from the lid
Agent_1 must keep its gripper over the table
Agent_1 must keep its gripper above 10 cm below the table
Agent_1 must keep its gripper 10 cm above the table
Agent_1 must keep its gripper above 10 cm over the pot
Agent_1 must not keep its gripper under 10 cm
The gripper of Agent_1 must not be above 10 cm
Agent_1 must move faster than 10 cm/s
Agent_1 must not move slower than 10 cm/s
Agent_1 must move no slower than 10 cm/s
Agent_1 must move at least at 10 cm/s
Agent_1 must move at 10 cm/s
Agent_1 may move at most at 10 cm/s
Agent_1 must move the lid at most at 10 cm/s
Agent_1 must move its gripper at most at 10 cm/s when lifting the lid
Agent_1 must not move the steak faster than 10 cm/s
Agent_1 must keep the lid level within 5 degrees of the table
Agent_1 must not keep the lid level
Agent_1 may keep the lid level
Agent_1 must tilt the lid at most 5 deg
The lid must be vertical
The lid must be upright when Agent_2 lifts it
Keep the lid
Agent_1 must carry the steak level to the pot
Agent_1 must lift the lid level
Agent_1 must avoid the lid
Agent_1 must avoid touching the lid
Agent_1 must not touch the lid
Agent_1 must not hit the lid
Agent_1 must hit Agent_2
Agent_1 must not collide with the lid
Agent_1 must collide with Agent_2
Agent_1 must not avoid Agent_2
Agent_1 must not avoid collisions with Agent_2
Do not avoid collision between Agent_1 and Agent_2
Avoid no collision between Agent_1 and Agent_2
Avoid collision between Agent_1 and Agent_2 and Agent_1
Avoid collisions of Agent_1 with the pot
Agent_1 must not touch the trajectory of Agent_2
Agent_1 must enter the zone (0, 0, 0) to (1, 1, 1)
Agent_1 must not avoid the zone (0, 0, 0) to (1, 1, 1)
Agent_1 must not stay out of the zone (0, 0, 0) to (1, 1, 1)
Agent_1 must stay in zone (0, 0, 0) to (1, 1, 1)
Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) until Agent_2 stops
Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) until Agent_2 begins
Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) after Agent_2 lifts the lid
Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) once Agent_2 lifts the lid
Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) when Agent_2 is not inside
Agent_1 must stay out of the zone (0, 0, 0) to (1, 1, 1) unless Agent_2 is inside
Agent_1 must not enter the area (0, 0, 0) to (10, 10, 10) cm
Agent_1 must not enter the area (0, 0, 0) cm to (10, 10, 10) cm
Agent_1 and Agent_2 may share the space
Agent_1 and Agent_2 may not share the space in turn
Agent_1 and Agent_2 may share the same space at the same time
Agent_1 and Agent_2 must not keep the same height
Agent_1 must not grasp the lid by its knob
Agent_1 must hold the lid by its knob
Agent_1 must grasp the lid by its knob from above
Agent_1 must grasp the lid at its knob within 5 s
Agent_1 must place the steak in the pot
Agent_1 must place the steak in the pot within 5 s
Agent_1 must approach the lid
Agent_1 must reach the lid within 5 s
Agent_1 must not approach the lid from above
Agent_1 must pick up the lid vertically
Agent_1 must take the lid horizontally
The gripper of Agent_1 is perpendicular to the lid when lifting it
The gripper of Agent_1 must not be perpendicular to the lid
Agent_1 must keep its gripper vertical until placing the steak
Agent_1 must start within 10 s
Agent_1 must begin its task within 10 s
Agent_1 must stop within 10 s
Agent_1 must not finish within 10 s
Agent_1 must finish not within 10 s
Agent_1 must finish within at least 10 s
Agent_1 must finish within 10 s or 20 s
Agent_1 must finish within 10 to 20 s
Agent_1 must finish within 10-20 s
Agent_1 must finish within less than 10 s
Agent_1 must be finished within 10 s
Agent_1 must lift the lid within 10 s again
Agent_1 must lift the lid by 10 cm
Agent_1 must lift the lid by 10 cm within 10 s
Agent_1 grasped the lid within 10 s
Agents must keep the same height
Agent_1 must finish placing the steak before Agent_2 finishes lifting the lid
First Agent_2 begins to lift the lid, then Agent_1 places the steak
First Agent_2 finishes, then Agent_1 has placed the steak
Agent_2 lifts the lid, and then Agent_1 finishes placing the steak
Agent_1 must finish within 20 minutes
Agent_2 must keep the lid level within 5 degs
Agents 1 and 2 must keep their grippers at least 4 inches apart
Agent_1 and Agent_2 must lift the barrier together within 1 s
Agent_1 and Agent_2 must lift the barrier together within 600 s of each other
Agent_1 and Agent_2 must lift the barrier together within 1 minute of each other
Agent_1 and Agent_2 must lift the barrier together, at most 11 s apart
Agent_1 and Agent_2 must lift the barrier together to within 11 s
Agent_1 and Agent_2 must perform their tasks simultaneously within 30 seconds
Agent_1 must pick up the steak within 3 s
Agent_2 must pick up the lid before Agent_1 places the steak
Agent_2 must take the lid off before Agent_1 places the steak
Agent_2 must remove the lid before Agent_1 places the steak
Agent_2 must open the pot before Agent_1 places the steak
The lid must be removed by Agent_2 before Agent_1 places the steak
Agent_1 must push the pot before Agent_2 begins
Agent_1 must keep the steak vertical
Agent_1 had better place the steak after Agent_2 lifts the lid
Agent_1 must try to finish within 10 s
Agent_1 must preferably finish within 10 s
Agent_1 must finish within approximately 10 s
Agent_1 must finish within 10 s at the latest
Agent_1 must finish within the first 10 s
Agent_1 must finish within 10 s of starting
Agent_1 must finish within 10 s of Agent_2
Agent_1 must finish within 10 s after Agent_2 has finished
Agent_1 must be done with its task within 10 s
Agent_1 must be finished with the steak within 10 s
Agent_1 must finish the steak within 10 s
Agent_1 must complete the steak within 10 s
Agent_1 must lift the steak within 10 s of each other
Agent_1 must lift the steak within 10 cm
Agent_1 must lift the steak within 10 s and hold it
Agent_1 must place the steak within 10 s on the pot
Agent_1 must not be done within 10 s
Agent_1 must end up within 10 s
Agent_2 must lift and hold the lid before Agent_1 places the steak
Agent_2 must lift the lid before Agent_1 places the steak in the pot
Agent_2 must lift the lid just before Agent_1 places the steak
Agent_2 must lift the lid shortly before Agent_1 begins
Agent_2 must lift the lid 2 s before Agent_1 begins
Agent_2 must lift the lid at least 2 s before Agent_1 begins
Agent_2 must lift the lid before or while Agent_1 places the steak
Agent_2 must lift the lid before Agent_1 begins and after Agent_1 ends
Agent_2 must lift the lid before Agent_1 begins again
Agent_2 must lift the lid before Agent_1 does
Agent_2 must lift the lid before Agent_1
Agent_2 lifts the lid, not before Agent_1 begins
Agent_2 must not lift the lid before Agent_1 begins
Agent_2 must not lift the lid until Agent_1 begins
Agent_2 must not lift the lid until Agent_1 moves
Agent_2 must not lift the lid until Agent_1 has begun
Agent_2 can begin only after Agent_1 is done
Agent_2 may begin only after Agent_1 is done
Agent_2 must begin only after Agent_1 is done
Agent_2 must begin after Agent_1 is done
Agent_2 begins once Agent_1 has finished
Agent_2 must begin at least 2 s after Agent_1 is done
Agent_2 must begin as soon as Agent_1 is done
After Agent_1 is done, Agent_2 must begin
After Agent_1 is done, Agent_2 may lift the lid
After Agent_1 is done, Agent_2 must not lift the lid
Only after Agent_1 is done must Agent_2 lift the lid
Once Agent_1 starts, Agent_2 must lift the lid
While Agent_1 places the steak, Agent_2 must hold the lid
Agent_2 must hold the lid while Agent_1 places the steak
Agent_2 must hold the lid until Agent_1 has placed the steak
Agent_2 must not put the lid down before the steak is on the pot
Agent_2 must keep holding the lid until Agent_1 has placed the steak
Agent_2 must stop lifting the lid before Agent_1 begins
Agent_2 must wait before lifting the lid
Agent_2 must wait until Agent_1
Agent_2 must wait 2 s
Agent_2 must wait 2 s before lifting the lid
Agent_2 must wait 2 s after lifting the lid
Agent_2 must wait 2 s after Agent_1 lifts the steak before lifting the lid
Agent_2 must wait less than 2 s after Agent_1 lifts the steak
Agent_2 must wait until after Agent_1 lifts the steak
Agent_2 must wait until 2 s after Agent_1 lifts the steak
Agent_2 must wait until Agent_1 lifts the steak or finishes
Agent_2 must wait until Agent_1 does not lift the steak
Agent_2 must wait until Agent_1 never lifts the steak
Agent_2 need not wait until Agent_1 lifts the steak
Agent_2 waits for Agent_1
Agent_2 waits for Agent_1 to have lifted the steak
Agent_2 waits for Agent_1 to not lift the steak
Agent_2 waits for the steak to be on the pot
Agent_2 waits for the steak to be lifted by Agent_1
Agent_1 and Agent_2 wait until the lid is on the table
Agent_1 must wait until the lid is on the table within 10 s
Agent_1 must wait until the lid is above the table
Agent_1 must wait until the lid is on Agent_2
Agent_1 must wait until the lid is lifted
Agent_1 must wait until the lid is off the pot
Agent_1 must wait until the lid is on the pot or the table
Agent_1 must wait until the lid has been put on the table by Agent_2
The lid must not be on the table before Agent_1 begins
The lid must be off the table before Agent_1 begins
The lid must be lifted before Agent_1 begins
The lid must be lifted by Agent_2 within 10 s
The lid must be lifted by Agent_2 after Agent_1 begins
The lid must be lifted by Agent_1 and Agent_2 before Agent_1 begins
Lift the lid before placing the steak
Agent_1 and Agent_2 must lift the lid before Agent_1 places the steak
Agent_1 and Agent_2 must finish before Agent_2 begins
Agent_1 and Agent_2 must simultaneously lift the barrier
Agent_1 and Agent_2 simultaneously grasp the barrier
Agent_1 and Agent_2 must grasp the barrier almost simultaneously
Agent_1 and Agent_2 must grasp the barrier together and lift it
Agent_1 and Agent_2 must grasp the barrier together before Agent_1 lifts it
Agent_1 and Agent_2 must grasp the barrier simultaneously for 2 s
Agent_1 and Agent_2 must grasp the barrier simultaneously after 2 s
Agent_1 and Agent_2 must grasp the barrier simultaneously within 2 cm
Agent_1 and Agent_2 must grasp the barrier simultaneously within 2 cm of each other
Agent_1 and Agent_2 must grasp the barrier within 2 s of each other
Agent_1 and Agent_2 must grasp the barrier within 2 s simultaneously
Agent_1 and Agent_2 must place the barrier together, at least 2 s apart
Agent_1 and Agent_2 must place the barrier together apart
Agent_1 and Agent_2 must keep the barrier together
Agent_1 and Agent_2 must put the barrier together
Agent_1 and Agent_2 must bring the barrier together
Agent_1 and Agent_2 must stack the barrier together
Agent_1 and Agent_2 must set the barrier together
Agent_1 and Agent_2 must end their tasks together
Agent_1 and Agent_2 must do the same task simultaneously
Agent_1 and Agent_2 must perform different tasks simultaneously
Agent_1 and Agent_2 may perform tasks simultaneously
Agent_1 and Agent_2 need not perform tasks simultaneously
Agent_1 and Agent_2 must perform no tasks simultaneously
Agent_1 and Agent_2 never perform tasks simultaneously
Agent_1 and Agent_2 may share the same space, one after the other
Agent_1 and Agent_2 may only share the same space one after the other
Agent_1 and Agent_2 can never share the same space one after the other
Agent_1 and Agent_2 may enter the same space one after the other
Agent_1 and Agent_2 must not share the same space
Agent_1 must not share the same space as Agent_2
Agent_1 must occupy the same space as Agent_2
Agent_1 must not occupy the same space as other agents
Agent_1 must not be in the same space as Agent_2
Agent_1 may enter the space of Agent_2
Agent_1 must not enter the space of other agents
Agent_1 must avoid collisions with other agents
Agent_1 must avoid collision with the lid
Agent_1 must avoid Agent_2 and the lid
Agent_1 must avoid Agent_2 while Agent_2 lifts the lid
Agent_1 must not collide with Agent_2 or the lid
Agent_1 must not collide with anything
Agent_1 must not collide with itself
Agent_1 must not collide with any agents
Agent_1 must not collide with the objects of Agent_2
Agent_1 must not collide with other objects than the lid
Agent_1 may collide with Agent_2
Agent_1 may touch Agent_2
Agent_1 must hardly touch Agent_2
Agent_1 must not fail to touch Agent_2
Agent_1 should not hit the lid with the steak
Agent_1 must hit the lid with the steak
Agent_1 must not intersect with the path of the lid
Avoid collisions
Avoid collisions between agents
Avoid collision between all agents
Avoid collision between Agent_1, Agent_2
Avoid collision between the lid and the pot
Avoid collision between Agent_1 and the lid
Avoid collision between Agent_1 and the objects in the zone (0, 0, 0) to (1, 1, 1)
Never avoid collision between Agent_1 and Agent_2
Allow collision between Agent_1 and Agent_2
No collision between Agent_1 and Agent_2
The agents may not collide
Both arms must not collide
Arms must collide
Agent_1 and Agent_2 must keep their grippers at least 10 cm apart while lifting the lid
Agent_1 and Agent_2 must keep their grippers at least 10 cm apart vertically
Agent_1 and Agent_2 must keep their grippers at least 10 cm apart until Agent_1 finishes
Agent_1 and Agent_2 must keep their grippers at least 10 to 20 cm apart
Agent_1 and Agent_2 must keep their grippers at least -10 cm apart
Agent_1 and Agent_2 must keep their grippers less than 10 cm apart
Agent_1 and Agent_2 must keep their grippers no less than 10 cm apart
Agent_1 and Agent_2 must keep their grippers more than 10 cm apart
Agent_1 and Agent_2 must keep their bases at least 10 cm apart
Agent_1 and the lid must keep at least 10 cm apart
The gripper of Agent_1 and Agent_2 must be at least 10 cm apart
The arms of Agent_1 and Agent_2 may be at least 10 cm apart
The grippers of Agent_1 must be at least 10 cm apart
Agent_1 must open its gripper at least 10 cm
Agent_1 must stay at least 10 cm above Agent_2
Agent_1 must stay at least 10 cm from Agent_1
Agent_1 must keep its gripper at least 10 cm from Agent_2
Agent_1 must keep its gripper at least 10 cm above the table
Agent_1 must keep its gripper above 10 cm and below 50 cm
Agent_1 must keep its gripper above the lid
Agent_1 must keep its gripper above 10 cm over the lid
Agent_1 must keep its gripper above 10 cm until Agent_2 finishes
Agent_1 must keep its gripper above -10 cm
Agent_1 must keep its gripper not above 10 cm
Agent_1 must keep its gripper below 10 cm from Agent_2
Agent_1 must keep its arm below 10 cm
Agent_1 must keep the steak below 10 cm
Agent_1 must raise its gripper above 10 cm
Agent_1 must lift its gripper
Agent_1 must close its gripper
The gripper of Agent_1 may stay above 10 cm
The grippers of Agent_1 must stay above 10 cm
The gripper of the lid must stay above 10 cm
Agent_1 must move its gripper at most at 10 cm
Agent_1 must move at most 10 cm/s
Agent_1 must move at no less than 10 cm/s
Agent_1 must not move at most at 10 cm/s
Agent_1 never moves slower than 10 cm/s
Agent_1 never moves no faster than 10 cm/s
Agent_1 must move with at most 10 cm/s
Agent_1 must move at 10 cm/s at most
Agent_1 must move slowly
Agent_1 must move faster than Agent_2
Agent_1 must not move faster than Agent_2
Agent_1 may move faster than 10 cm/s
Agent_1 must not move faster than 10 cm/s while lifting the lid
Agent_1 must not move faster than 10 cm/s until Agent_2 finishes
Agent_1 must not move faster than 10 cm/s within 10 s
Agent_1 must not turn faster than 10 deg/s
Agent_1 must not move faster than 10 deg/s
Agent_1 must not move more than 10 cm
Agent_1 must not move faster than 10 cm/s before Agent_2 begins
Agent_1 and Agent_2 must not move faster than 10 cm/s
Agent_1 must move no faster than 10 cm/s and finish within 10 s
Agent_1 must keep the lid level within 10 s
Agent_1 must keep the lid level within 10 cm
Agent_1 must keep the lid level for 10 s
Agent_1 must keep the lid level while lifting it
Agent_1 must keep the lid level until Agent_2 finishes
Agent_1 must keep the lid level with the pot
Agent_1 must keep the lid level at 10 deg
Agent_1 must keep the lid tilted within 10 deg
Agent_1 must keep the lid and the steak level
Agent_1 must keep its gripper level
Agent_1 must keep its gripper level within 10 deg
Agent_1 must hold level the lid
Agent_1 must hold the lid level within -5 deg
Agent_1 keeps the lid level
Agent_1 and Agent_2 must keep the barrier level
The lid must be level with the pot
The lid must be kept horizontal by Agent_2
The lid stays level
The lid may stay level
The lid must be level or upright
The gripper must be level
The gripper of Agent_1 must be level
The gripper of Agent_1 must be vertical
The gripper of Agent_1 must be vertical to the table
The gripper of Agent_1 must be vertical above the lid
The gripper of Agent_1 must be vertical within 5 deg
The gripper of Agent_1 must be vertical at the lid within 5 deg
The gripper of Agent_1 must be vertical at the lid when grasping the steak
The gripper of Agent_1 must be vertical at the lid before grasping it
The gripper of Agent_1 must be vertical at the lid unless lifting it
The gripper of Agent_1 must be parallel to the lid
The gripper of Agent_1 must be almost perpendicular to the lid
The gripper of Agent_1 must become perpendicular to the lid
The gripper of Agent_1 is not perpendicular to the lid
The gripper of Agent_1 stays perpendicular while lifting the lid
The gripper of Agent_1 stays horizontal when the lid is lifted
The gripper of Agent_1 stays horizontal when Agent_2 lifts the lid
The gripper of Agent_1 must stay upright while lifting the lid
The grippers of Agent_1 and Agent_2 must be level at the barrier
The gripper of Agent_1 should be vertical at the lid and the pot
Agent_1 must keep its gripper level when removing the lid
Agent_1 must keep its gripper level when opening the pot
Agent_1 must keep its gripper vertical when pushing the lid
Agent_1 keeps the gripper vertical when picking up the lid
Agent_1 must hold the gripper vertical while moving
Agent_1 must hold the lid vertical while moving it
Agent_1 must approach the lid slowly from above
Agent_1 must approach the lid from above the pot
Agent_1 must approach the lid from above within 5 s
Agent_1 must approach the lid not from above
Agent_1 must never approach the lid from above
Agent_1 may approach the lid from above
Agent_1 must approach the lid from the left side
Agent_1 must approach the lid from the left
Agent_1 must approach the lid from below
Agent_1 must approach Agent_2 from above
Agent_1 must approach the lid perpendicularly to the table
Agent_1 must reach for the lid from above
Agent_1 must reach over the lid
Agent_1 must grasp the lid from above or from the side
Agent_1 must grasp the lid from above at its knob
Agent_1 must grasp the lid at its knob from above
Agent_1 must grasp the lid at its knob and lift it
Agent_1 must grasp the lid at its knob or its center
Agent_1 must grasp the lid at its center
Agent_1 must grasp the lid at the knob of the pot
Agent_1 must grasp the lid near its knob
Agent_1 must grasp the lid away from its knob
Agent_1 must grasp the lid not at its knob
Agent_1 must grasp the lid anywhere but at its knob
Agent_1 may grasp the lid at its knob
Agent_1 might grasp the lid at its knob
Agent_1 must not grasp the knob of the lid
Agent_1 must release the lid at its knob
Agent_1 must hold the lid at its knob
Agent_1 must lift the lid by its knob
Agent_1 must lift the lid at its knob
Agent_1 must open the lid by its knob
Agent_1 must remove the lid by its knob
Agent_1 must push the lid at its knob
Agent_1 must press the knob of the lid
Agent_1 must pick the lid up by its knob
Agent_1 must place the steak inside the pot
Agent_1 must place the steak into the pot
Agent_1 must drop the steak into the inside of the pot
Agent_1 must remove the steak from the inside of the pot
Agent_1 must carry the steak to the inside of the pot
Agent_1 must not place the steak in the inside of the pot
Agent_1 must place the steak at the center of the steak
Agent_1 must place the steak at the center point of the pot
Agent_1 must place the steak on the knob of the lid
Agent_1 and Agent_2 must keep a consistent gripper height within 1 cm
Agent_1 and Agent_2 must keep a consistent height until Agent_1 finishes
Agent_1 and Agent_2 must keep a height of 10 cm
Agent_1 and Agent_2 must keep the same distance
Agent_1 and Agent_2 must keep the same height as the lid
Agent_1 and Agent_2 must maintain different heights
Agent_1 must keep the same height
Agents must maintain the same height
Keep the gripper height at 10 cm
Keep the lid away
Keep the lid upright until Agent_1 finishes
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) for 10 s
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) within 10 s
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) unless Agent_2 is in it
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while Agent_2 is not there
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while Agent_2 is out of it
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until Agent_2 is in it
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until the lid is there
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) while Agent_1 is in it
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until Agent_1 has finished
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) until Agent_2 removes the lid
Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 1) before Agent_2 begins
Agent_1 must stay out of zone (0, 0, 0) and (1, 1, 1)
Agent_1 must stay inside of zone (0, 0, 0) to (1, 1, 1)
Agent_1 may stay out of zone (0, 0, 0) to (1, 1, 1)
Agent_1 may enter zone (0, 0, 0) to (1, 1, 1)
Agent_1 must keep the lid out of zone (0, 0, 0) to (1, 1, 1)
Agent_1 and Agent_2 must stay out of zone (0, 0, 0) to (1, 1, 1)
Agent_2 lifts the lid first, then Agent_1 finishes
Agent_2 must have finished before Agent_1 is done
Once Agent_2 has lifted the lid, Agent_1 must finish
Agent_1 must finish once Agent_2 has lifted the lid
Agent_1 must end only after Agent_2 lifts the lid
Agent_1 may stop once Agent_2 has lifted the lid
Agent_1 must wait for Agent_2 to start
Agent_1 waits until Agent_2 has started lifting the lid
Agent_1 must not begin before Agent_2 begins
Agent_1 must begin before Agent_2 finishes
Agent_2 must start lifting the lid before Agent_1 begins
Agent_2 starts, then Agent_1 starts
Agent_1 starts after Agent_2 has finished
Agent_1 must start 2 s after Agent_2 starts
Agent_1 must lift the steak at least 2 s after Agent_2 begins
Agent_1 must pause until Agent_2 has finished
Agent_1 must halt until Agent_2 has finished
Agent_1 stops until Agent_2 has finished
Agent_1 must be still until Agent_2 has finished
Agent_1 must not move while Agent_2 moves
Both agents must lift the barrier together within 5 s
Agents 1 and 2 lift the barrier in sync within 20 s
Agent_1 and Agent_2 must lift the barrier together in 10 s
Agent_1 and Agent_2 must lift the barrier simultaneously by 10 s
Agent_1 and Agent_2 must lift the barrier simultaneously, within 3 s
Agent_1 and Agent_2 must grasp the barrier concurrently within 0.1 minutes
Agent_1 and Agent_2 have to pick up the barrier together
Agent_1 and Agent_2 must raise the barrier together vertically
Agent_1 and Agent_2 must lift the barrier vertically
Agent_1 must raise the lid straight up
Agent_1 must place the lid horizontally
Agent_1 must lay the lid horizontally
Agent_1 must transport the lid vertically
Agent_1 must bring the steak from the side
Agent_1 must hold the steak from above
Agent_1 must insert the steak perpendicularly
Agent_1 must strike the lid perpendicularly
Agent_1 must open the lid from the side
Agent_1 must remove the lid vertically
Agent_1 takes off the lid before Agent_2 places the steak
Agent_1 puts away the lid before Agent_2 places the steak
Agent_1 removes the lid, then Agent_2 places the steak
Agent_2 waits until the lid is removed by Agent_1
Agent_2 waits until Agent_1 has removed the lid
Agent_2 must wait for Agent_1 to remove the lid
Agent_2 must wait 2 s after Agent_1 removes the lid
When removing the lid Agent_1 must keep its gripper level
Agent_1 must keep its gripper level while taking the lid
Agents 1 and 2 must keep the same height when picking up the lid
Agent_1 must finish removing the lid within 10 s
Agent_1 must finish within ten seconds
Agent_1 must finish within 0.5 centimeters
Agent_1 must not move faster than 12 meters per minute
Agent_1 must keep its gripper below 40 centi meters
Agent_1 must keep its gripper below 400,0 mm
Agent_1 must keep its gripper below 40 cm 5 mm
""".strip().splitlines()
