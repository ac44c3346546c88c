package lsfb.recorder;

import android.content.Context;
import android.hardware.Sensor;
import android.hardware.SensorEvent;
import android.hardware.SensorEventListener;
import android.hardware.SensorManager;
import android.os.Handler;
import lsfb.sidecar.Inertial;
import lsfb.sidecar.Records;

/** Gyroscope, accelerometer and magnetic field, raw: what the system corrects jumps when it learns. */
final class Sensors implements SensorEventListener {
  private static final int FASTEST = SensorManager.SENSOR_DELAY_FASTEST;
  /** Nothing is collected in the sensor hub: a sample is told when it was taken. */
  private static final int NO_LATENCY = 0;

  private final SensorManager manager;
  private final Outlet outlet;
  private final Inertial inertial = new Inertial();

  Sensors(Context context, Outlet outlet) {
    manager = (SensorManager) context.getSystemService(Context.SENSOR_SERVICE);
    this.outlet = outlet;
  }

  void start(Handler thread) {
    int[] types = {
      Sensor.TYPE_GYROSCOPE_UNCALIBRATED, Sensor.TYPE_ACCELEROMETER_UNCALIBRATED, Sensor.TYPE_MAGNETIC_FIELD_UNCALIBRATED
    };
    for (int type : types) {
      Sensor sensor = manager.getDefaultSensor(type);
      if (sensor == null || !manager.registerListener(this, sensor, FASTEST, NO_LATENCY, thread)) {
        outlet.problem("this phone has no sensor of type " + type);
      }
    }
  }

  void stop() {
    manager.unregisterListener(this);
  }

  @Override
  public void onSensorChanged(SensorEvent event) {
    // The first three; the next three are the bias that the system takes away elsewhere.
    double[] axes = {event.values[0], event.values[1], event.values[2]};
    switch (event.sensor.getType()) {
      case Sensor.TYPE_GYROSCOPE_UNCALIBRATED:
        inertial.rate(event.timestamp, axes);
        break;
      case Sensor.TYPE_ACCELEROMETER_UNCALIBRATED:
        for (Inertial.Sample sample : inertial.force(event.timestamp, axes)) {
          outlet.put(Outlet.IMU, sample.timeNs, Records.imu(sample.timeNs, "imu", sample.rate, sample.force));
        }
        break;
      default:
        outlet.put(Outlet.MAGNETIC, event.timestamp, Records.magnetic(event.timestamp, "imu", axes));
    }
  }

  @Override
  public void onAccuracyChanged(Sensor sensor, int accuracy) {
    // Of raw samples it says nothing.
  }
}
