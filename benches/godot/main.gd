# Samples the fields of jobs.json at the points of points.bin, draws the knot, and leaves the results in window.result.
extends Node3D


func _ready() -> void:
	var facts: Dictionary = JSON.parse_string(FileAccess.get_file_as_string("res://jobs.json"))
	var raw := FileAccess.get_file_as_bytes("res://points.bin")
	var points := ImageTexture.create_from_image(Image.create_from_data(1000, 1, false, Image.FORMAT_RGBAF, raw))
	var samples := {}
	for job in facts["jobs"]:
		var path: String = "res://" + job["file"]
		var field: Texture3D = sheet(path) if path.ends_with(".exr") else load(path)
		var settings := {"field": field, "points": points, "lower": vector(job["bounds"][0]), "upper": vector(job["bounds"][1])}
		samples[job["file"]] = []
		for filtered in [false, true]:
			settings["filtered"] = filtered
			samples[job["file"]].append(Marshalls.raw_to_base64((await sampled(settings)).get_data()))
	var picture := await drawn(load("res://knot.dds"), vector(facts["knot"][0]), vector(facts["knot"][1]))
	var results := {
		"version": Engine.get_version_info()["string"],
		"samples": samples,
		"picture": Marshalls.raw_to_base64(picture.save_png_to_buffer()),
	}
	JavaScriptBridge.eval("window.result = " + JSON.stringify(JSON.stringify(results)))


func vector(list: Array) -> Vector3:
	return Vector3(list[0], list[1], list[2])


# A sheet as the importer "3d_texture" cuts it by these settings (resource_importer_layered_texture.cpp).
func sheet(path: String) -> Texture3D:
	var settings := ConfigFile.new()
	settings.load(path + ".cfg")
	var columns: int = settings.get_value("params", "slices/horizontal")
	var rows: int = settings.get_value("params", "slices/vertical")
	var raw := FileAccess.get_file_as_bytes(path)
	var picture := Image.create_from_data(raw.decode_u32(0), raw.decode_u32(4), false, Image.FORMAT_RF, raw.slice(8))
	var size := Vector2i(picture.get_width() / columns, picture.get_height() / rows)
	var slices: Array[Image] = []
	for row in rows:
		for column in columns:
			slices.append(picture.get_region(Rect2i(Vector2i(column, row) * size, size)))
	var field := ImageTexture3D.new()
	field.create(Image.FORMAT_RF, size.x, size.y, slices.size(), false, slices)
	return field


func material(path: String, settings: Dictionary) -> ShaderMaterial:
	var shader := Shader.new()
	shader.code = FileAccess.get_file_as_string(path)
	var made := ShaderMaterial.new()
	made.shader = shader
	for name in settings:
		made.set_shader_parameter(name, settings[name])
	return made


# One pixel for each point; its four bytes are the bits of the distance.
func sampled(settings: Dictionary) -> Image:
	var view := SubViewport.new()
	view.size = Vector2i(1000, 2)
	view.transparent_bg = true
	view.disable_3d = true
	var area := ColorRect.new()
	area.size = view.size
	area.material = material("res://sample.gdshader", settings)
	view.add_child(area)
	return await shown(view)


func shown(view: SubViewport) -> Image:
	view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	add_child(view)
	for frame in 3:
		await RenderingServer.frame_post_draw
	var picture := view.get_texture().get_image()
	view.queue_free()
	return picture


func drawn(field: Texture3D, lower: Vector3, upper: Vector3) -> Image:
	var view := SubViewport.new()
	view.size = Vector2i(480, 360)
	var body := MeshInstance3D.new()
	body.mesh = BoxMesh.new()
	body.mesh.size = upper - lower
	body.position = (lower + upper) / 2
	# A box has its vertices about its middle.
	var settings := {"field": field, "lower": lower - body.position, "upper": upper - body.position}
	body.material_override = material("res://field.gdshader", settings)
	view.add_child(body)
	# A plain mesh, half of it inside the knot.
	var ball := MeshInstance3D.new()
	ball.mesh = SphereMesh.new()
	ball.mesh.radius = 0.25 * (upper - lower).x
	ball.mesh.height = 0.5 * (upper - lower).x
	ball.material_override = StandardMaterial3D.new()
	ball.material_override.shading_mode = BaseMaterial3D.SHADING_MODE_UNSHADED
	ball.material_override.albedo_color = Color(0.35, 0.5, 0.7)
	ball.position = body.position
	view.add_child(ball)
	var camera := Camera3D.new()
	camera.fov = 40
	view.add_child(camera)
	camera.look_at_from_position(body.position + Vector3(0.9, 1.5, 2.4) * (upper - lower).x / 2, body.position)
	var world := WorldEnvironment.new()
	world.environment = Environment.new()
	world.environment.background_mode = Environment.BG_COLOR
	world.environment.background_color = Color(0.9, 0.92, 0.95)
	view.add_child(world)
	return await shown(view)
