package lsfb.recorder;

import android.content.Context;
import android.graphics.ImageFormat;
import android.hardware.camera2.CameraAccessException;
import android.hardware.camera2.CameraCaptureSession;
import android.hardware.camera2.CameraCharacteristics;
import android.hardware.camera2.CameraDevice;
import android.hardware.camera2.CameraManager;
import android.hardware.camera2.CaptureRequest;
import android.hardware.camera2.CaptureResult;
import android.hardware.camera2.TotalCaptureResult;
import android.media.Image;
import android.media.ImageReader;
import android.os.Handler;
import java.nio.ByteBuffer;
import java.util.Collections;
import java.util.HashMap;
import java.util.Map;
import lsfb.sidecar.FrameTimes;
import lsfb.sidecar.Records;

/** The camera at the back: grey images of 640 × 480, with what Camera2 says of each exposure. Nothing stabilises and nothing refocuses. */
final class Frames {
  private static final int WIDTH = 640;
  private static final int HEIGHT = 480;
  private static final int MOST_WAITING = 32;

  private final CameraManager manager;
  private final Outlet outlet;
  private Handler thread;
  private ImageReader reader;
  private CameraDevice camera;
  private int source;
  private int number;
  /** Images and their exposures come apart; the sensor's stamp joins them. */
  private final Map<Long, byte[]> images = new HashMap<>();
  private final Map<Long, TotalCaptureResult> exposures = new HashMap<>();

  Frames(Context context, Outlet outlet) {
    manager = (CameraManager) context.getSystemService(Context.CAMERA_SERVICE);
    this.outlet = outlet;
  }

  void start(Handler thread) {
    this.thread = thread;
    try {
      for (String id : manager.getCameraIdList()) {
        CameraCharacteristics known = manager.getCameraCharacteristics(id);
        Integer facing = known.get(CameraCharacteristics.LENS_FACING);
        if (facing != null && facing == CameraCharacteristics.LENS_FACING_BACK) {
          Integer said = known.get(CameraCharacteristics.SENSOR_INFO_TIMESTAMP_SOURCE);
          source = said == null ? 0 : said;
          manager.openCamera(id, opened, thread);
          return;
        }
      }
      outlet.problem("this phone has no rear camera");
    } catch (CameraAccessException | SecurityException e) {
      outlet.problem("the camera: " + e.getMessage());
    }
  }

  void stop() {
    if (camera != null) {
      camera.close();
    }
    if (reader != null) {
      reader.close();
    }
  }

  private final CameraDevice.StateCallback opened =
      new CameraDevice.StateCallback() {
        @Override
        public void onOpened(CameraDevice device) {
          camera = device;
          reader = ImageReader.newInstance(WIDTH, HEIGHT, ImageFormat.YUV_420_888, 8);
          reader.setOnImageAvailableListener(Frames.this::take, thread);
          try {
            device.createCaptureSession(Collections.singletonList(reader.getSurface()), configured, thread);
          } catch (CameraAccessException e) {
            outlet.problem("the camera: " + e.getMessage());
          }
        }

        @Override
        public void onDisconnected(CameraDevice device) {
          device.close();
          outlet.problem("another app is using the camera");
        }

        @Override
        public void onError(CameraDevice device, int code) {
          device.close();
          outlet.problem("the camera failed: " + code);
        }
      };

  private final CameraCaptureSession.StateCallback configured =
      new CameraCaptureSession.StateCallback() {
        @Override
        public void onConfigured(CameraCaptureSession session) {
          try {
            CaptureRequest.Builder request = camera.createCaptureRequest(CameraDevice.TEMPLATE_RECORD);
            request.addTarget(reader.getSurface());
            request.set(CaptureRequest.CONTROL_AF_MODE, CaptureRequest.CONTROL_AF_MODE_OFF);
            request.set(CaptureRequest.LENS_OPTICAL_STABILIZATION_MODE, CaptureRequest.LENS_OPTICAL_STABILIZATION_MODE_OFF);
            request.set(CaptureRequest.CONTROL_VIDEO_STABILIZATION_MODE, CaptureRequest.CONTROL_VIDEO_STABILIZATION_MODE_OFF);
            session.setRepeatingRequest(request.build(), exposed, thread);
          } catch (CameraAccessException e) {
            outlet.problem("the camera: " + e.getMessage());
          }
        }

        @Override
        public void onConfigureFailed(CameraCaptureSession session) {
          outlet.problem("the camera does not support 640 × 480 images");
        }
      };

  private final CameraCaptureSession.CaptureCallback exposed =
      new CameraCaptureSession.CaptureCallback() {
        @Override
        public void onCaptureCompleted(CameraCaptureSession session, CaptureRequest request, TotalCaptureResult result) {
          Long stamp = result.get(CaptureResult.SENSOR_TIMESTAMP);
          if (stamp != null) {
            exposures.put(stamp, result);
            join(stamp);
          }
        }
      };

  private void take(ImageReader from) {
    try (Image image = from.acquireNextImage()) {
      if (image == null) {
        return;
      }
      Image.Plane plane = image.getPlanes()[0];
      ByteBuffer rows = plane.getBuffer();
      // The last row may end before its padding.
      byte[] luminance = new byte[plane.getRowStride() * HEIGHT];
      rows.get(luminance, 0, Math.min(rows.remaining(), luminance.length));
      long stamp = image.getTimestamp();
      images.put(stamp, Records.image(stamp, "cam0", WIDTH, HEIGHT, plane.getRowStride(), luminance));
      join(stamp);
    }
  }

  private void join(long stamp) {
    byte[] image = images.get(stamp);
    TotalCaptureResult exposure = exposures.get(stamp);
    if (image != null && exposure != null) {
      images.remove(stamp);
      exposures.remove(stamp);
      FrameTimes times =
          new FrameTimes(
              source,
              stamp,
              orZero(exposure.get(CaptureResult.SENSOR_EXPOSURE_TIME)),
              orZero(exposure.get(CaptureResult.SENSOR_ROLLING_SHUTTER_SKEW)));
      Integer iso = exposure.get(CaptureResult.SENSOR_SENSITIVITY);
      Float focal = exposure.get(CaptureResult.LENS_FOCAL_LENGTH);
      boolean isKnown = times.clockId.equals(Records.BOOT_CLOCK);
      outlet.put(isKnown ? Outlet.IMAGE : Outlet.IMAGE_OF_UNKNOWN_CLOCK, times.timeNs, image);
      byte[] meta = times.record("cam0", number++, iso == null ? 0 : iso, focal == null ? 0 : focal);
      outlet.put(isKnown ? Outlet.FRAME_META : Outlet.FRAME_META_OF_UNKNOWN_CLOCK, times.timeNs, meta);
    }
    if (images.size() > MOST_WAITING || exposures.size() > MOST_WAITING) {
      outlet.problem("the camera does not report exposure times");
      images.clear();
      exposures.clear();
    }
  }

  private static long orZero(Long value) {
    return value == null ? 0 : value;
  }
}
